"""What a user would lose: the first programs he starts from."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

import lidarcodec
from tests.apps.streams import Loop
from tests.command_line import environment
from tests.packets import read_plain_pcap
from tests.transport.conftest import free_port
from tests.transport.test_contract import eventually

CLIENTS = Path(__file__).resolve().parents[2] / "clients" / "python"


@pytest.fixture
def endpoint():
    """A publisher that runs, and where to connect to it."""
    address = f"tcp/127.0.0.1:{free_port()}"
    with lidarcodec.Publisher(Loop(), endpoints=lidarcodec.Endpoints(listen=(address,))):
        yield address


def run(name: str, *words: str) -> str:
    command = [sys.executable, str(CLIENTS / name), *words, "--seconds", "0.5"]
    return subprocess.run(command, capture_output=True, text=True, check=True, timeout=60).stdout


def test_a_live_stream_becomes_a_capture(endpoint, tmp_path):
    out = tmp_path / "live.pcap"
    assert "packets in" in run("to_pcap.py", str(out), "--connect", endpoint)
    packets = read_plain_pcap(out)
    assert len(packets) % 348 == 0
    known = {payload[:1200] for payload in Loop(1).payloads()}
    assert packets
    assert all(packet.payload[:1200] in known for packet in packets)


def test_a_live_stream_becomes_points(endpoint):
    said = run("to_cloud.py", "--connect", endpoint)
    assert said.startswith("frame ")
    assert "points, nearest above the road" in said


@pytest.mark.parametrize("words", [["to_pcap.py", "live.pcap", "car"], ["to_cloud.py", "car"]])
def test_what_cannot_be_is_reported_in_a_line(words, tmp_path):
    command = [sys.executable, str(CLIENTS / words[0]), *words[1:]]
    refused = subprocess.run(
        command, capture_output=True, text=True, check=False, timeout=60, cwd=tmp_path, env=environment()
    )
    assert refused.returncode == 1
    assert refused.stderr.startswith(f"{words[0].removesuffix('.py')}: 'car' is not a stream")


@pytest.mark.sweep
def test_whoever_has_seen_enough_gets_what_came(endpoint, tmp_path):
    out = tmp_path / "live.pcap"
    command = [sys.executable, str(CLIENTS / "to_pcap.py"), str(out), "--connect", endpoint, "--seconds", "1e6"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert eventually(lambda: out.exists() and out.stat().st_size > 10**6, 60)
        process.send_signal(signal.SIGINT)
        said, complained = process.communicate(timeout=60)
    assert (process.returncode, complained) == (0, "")
    assert "packets in" in said
    assert len(read_plain_pcap(out)) % 348 == 0
