"""Each connection is an open file. Strangers who only connect must not take what a vehicle needs to record."""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
from pathlib import Path

import pytest

from tests.command_line import COMMAND, run
from tests.transport.conftest import free_port
from tests.transport.test_contract import eventually

pytest.importorskip("cryptography")

USUAL = 200
"""Stands for the usual limit of 1,024."""
STRANGERS = 300


def recorded(folder: Path) -> int:
    """Bytes of all recordings."""
    return sum(path.stat().st_size for path in (folder / "rec").glob("*"))


@pytest.mark.sweep
def test_strangers_who_only_connect_end_no_recording(tmp_path: Path) -> None:
    """The vehicle had no handle left: no file could be begun, and no state told."""
    port, health = free_port(), tmp_path / "health.json"
    made = run("certs", tmp_path / "d", "--vehicle", "car-7@127.0.0.1", "--viewer", "anna", "--port", port)
    assert made.returncode == 0, made.stderr
    words_of_anna = ("car-7/lidar", "--zenoh-config", tmp_path / "d" / "viewer-anna.json5")
    words = ["publish", "sim:street?sensor=vlp16", "--rate", "4", "--record", tmp_path / "rec", "--health-file", health]
    words += ["--zenoh-config", tmp_path / "d" / "vehicle-car-7.json5"]
    limited = ["sh", "-c", f'ulimit -Sn {USUAL}; exec "$@"', "sh", *COMMAND, *map(str, words)]
    without_gate = os.environ | {"LIDARCODEC_GATE": "off"}
    car = subprocess.Popen(limited, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=without_gate)
    try:
        with contextlib.ExitStack() as stack:
            eventually(lambda: run("subscribe", *words_of_anna, "--frames", 1).returncode == 0, 60.0)
            for _ in range(STRANGERS):
                stack.enter_context(socket.create_connection(("127.0.0.1", port), 5))
            assert eventually(lambda: sum(1 for _ in Path(f"/proc/{car.pid}/fd").iterdir()) > STRANGERS, 60.0)
            before = recorded(tmp_path)
            assert run("health", "--health-file", health).returncode == 0
            assert eventually(lambda: recorded(tmp_path) > before, 60.0)
    finally:
        car.terminate()
        _, complaint = car.communicate(timeout=60)
    assert car.returncode == 0, complaint
    assert "stopped" not in complaint
