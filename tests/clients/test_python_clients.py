"""What a user would lose: the first programs he starts from."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import lidarcodec
from lidarcodec.apps.demo_processes import free_port
from tests.apps.streams import Loop
from tests.packets import read_plain_pcap

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
