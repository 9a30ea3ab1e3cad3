"""`info` of a live sensor: what it sends, or within a limit of time that nothing comes."""

from __future__ import annotations

import json
import socket
import threading
import time
from pathlib import Path

import pytest

from lidarcodec.commands.info import source as inspect_source
from tests import packets as made
from tests.command_line import run_here, the_one_line
from tests.transport.conftest import free_port


def test_where_nothing_comes_it_ends_and_says_so(monkeypatch):
    """It waited without end and without a word."""
    monkeypatch.setattr(inspect_source, "QUIET_S", 1.0)
    port = free_port()
    began = time.monotonic()
    done = run_here("info", f"udp://127.0.0.1:{port}?wait=0")
    assert time.monotonic() - began < 30
    assert done.returncode == 1
    line = the_one_line(done)
    assert f"UDP 127.0.0.1 port {port}: no packet arrived within 1 s" in line
    assert "?idle=" in line
    assert "within 0.5 s" in the_one_line(run_here("info", f"udp://127.0.0.1:{port}?wait=0&idle=0.5"))


def test_a_port_that_is_none_is_named_and_nothing_that_the_user_did_not_write():
    done = run_here("info", "udp://127.0.0.1:99999")
    assert done.returncode == 1
    assert the_one_line(done).endswith("udp://127.0.0.1:99999: 99999 is no port: write a number up to 65535")


@pytest.mark.parametrize("count", [500, 4000])
def test_what_a_sensor_sends_is_shown_though_it_falls_silent(monkeypatch, count):
    monkeypatch.setattr(inspect_source, "QUIET_S", 2.0)
    port = free_port()
    packets = made.turning(count)

    def send() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sensor:
            sensor.bind(("127.0.0.1", 0))
            while f":{port:04X} " not in Path("/proc/net/udp").read_text():
                time.sleep(0.02)
            for packet in packets:
                sensor.sendto(packet.payload, ("127.0.0.1", port))
                time.sleep(0.0002)

    sending = threading.Thread(target=send, daemon=True)
    sending.start()
    done = run_here("info", f"udp://127.0.0.1:{port}?wait=0", "--json")
    sending.join(60)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["frames"] == 10 if count > 3700 else found["packets"] == count
