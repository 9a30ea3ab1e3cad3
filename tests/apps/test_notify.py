"""What a vehicle would lose: a service that hangs and is never started again, or one that works and is ended for it."""

from __future__ import annotations

import os
import re
import signal
import socket
import threading
import time
import urllib.request
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from lidarcodec.apps import notify
from lidarcodec.apps.notify import Manager, told_ready
from tests.command_line import run_here, start
from tests.transport.conftest import free_port

LIMIT_S = 60.0


@contextmanager
def listening(monkeypatch, address, watchdog_s=None):
    """The socket of a service manager; this process is its service. address: a path, or a name that begins with @"""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(f"\0{address[1:]}" if address.startswith("@") else address)
        manager.settimeout(LIMIT_S)
        monkeypatch.setenv("NOTIFY_SOCKET", address)
        if watchdog_s is not None:
            monkeypatch.setenv("WATCHDOG_USEC", str(int(watchdog_s * 1e6)))
        yield manager


def told(manager, until="STOPPING=1"):
    """Messages up to the one that ends them, with repeated ones once."""
    found = []
    while not found or found[-1] != until:
        text = manager.recv(4096).decode()
        found += [] if found and found[-1] == text else [text]
    return found


def test_publish_says_that_it_is_ready_and_that_it_ends(monkeypatch, tmp_path):
    with listening(monkeypatch, str(tmp_path / "notify")) as manager:
        words = ("publish", "sim:road?frames=2", "--rate", 100, "--vehicle", "car", "--sensor", "roof")
        assert run_here(*words, "--listen", f"tcp/127.0.0.1:{free_port()}").returncode == 0
        assert told(manager) == ["READY=1\nSTATUS=publishing car/roof", "STOPPING=1"]


def test_a_vehicle_of_several_sensors_is_one_service(monkeypatch, tmp_path):
    file = tmp_path / "publish.yaml"
    sensors = "".join(f"  - {{name: {name}, source: 'sim:road?frames=1', rate: 100}}\n" for name in ("roof", "left"))
    file.write_text(f"vehicle: car\nlisten: [tcp/127.0.0.1:{free_port()}]\nsensors:\n{sensors}")
    with listening(monkeypatch, "@lidarcodec-test-" + tmp_path.name) as manager:
        assert run_here("publish", "--config", file).returncode == 0
        assert told(manager) == ["READY=1\nSTATUS=publishing car/roof, car/left", "STOPPING=1"]


@pytest.mark.parametrize(
    ("words", "status"),
    [
        (("subscribe", "car/roof", "--listen"), "receiving car/roof"),
        (("serve", "--port", 0, "--database-url", "sqlite:///server.db", "--listen"), "serving"),
    ],
    ids=["subscribe", "serve"],
)
def test_a_receiver_and_a_server_say_so_until_a_signal_ends_them(monkeypatch, tmp_path, words, status):
    with listening(monkeypatch, str(tmp_path / "notify"), watchdog_s=0.3) as manager:
        process = start(*words, f"tcp/127.0.0.1:{free_port()}", cwd=tmp_path)
        try:
            assert told(manager, until="WATCHDOG=1") == [f"READY=1\nSTATUS={status}", "WATCHDOG=1"]
            process.send_signal(signal.SIGTERM)
            assert set(told(manager)) <= {"WATCHDOG=1", "STOPPING=1"}
            assert process.wait(LIMIT_S) == 0
        finally:
            process.kill()
            process.communicate()


def test_nothing_is_told_while_the_state_cannot_be_read(monkeypatch, tmp_path):
    hangs, asked = threading.Event(), threading.Semaphore(0)

    def state():
        asked.release()
        hangs.wait(LIMIT_S)

    with listening(monkeypatch, str(tmp_path / "notify"), watchdog_s=0.03) as manager:
        with told_ready("working", state):
            assert told(manager, until="READY=1\nSTATUS=working")
            assert asked.acquire(timeout=LIMIT_S)
            manager.settimeout(0.2)
            with pytest.raises(TimeoutError):
                manager.recv(4096)
            manager.settimeout(LIMIT_S)
            hangs.set()
            assert manager.recv(4096) == b"WATCHDOG=1"
        assert told(manager)[-1] == "STOPPING=1"


def fill(path):
    """Fill the socket at a path, as many other services do at the same time."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as other:
        other.setblocking(False)
        with suppress(BlockingIOError):
            while True:
                other.sendto(b"STATUS=of another service", str(path))


def test_a_server_whose_manager_does_not_listen_works_and_tells_it_later(monkeypatch, tmp_path):
    """The wait for a full socket stopped all viewers for a second each time, and READY=1 was told once."""
    with listening(monkeypatch, str(tmp_path / "notify"), watchdog_s=0.3) as manager:
        fill(tmp_path / "notify")
        words = ("serve", "--port", 0, "--database-url", "sqlite:///server.db", "--listen")
        process = start(*words, f"tcp/127.0.0.1:{free_port()}", cwd=tmp_path)
        try:
            port = int(re.search(r":(\d+) until", process.stdout.readline())[1])
            took, end = [], time.monotonic() + 6.0
            while time.monotonic() < end:
                before = time.monotonic()
                with urllib.request.urlopen(f"http://127.0.0.1:{port}/healthz", timeout=LIMIT_S) as answer:
                    answer.read()
                took.append(time.monotonic() - before)
            assert sum(one >= 1.0 for one in took) < 2, "one may be this machine's"
            assert told(manager, until="READY=1\nSTATUS=serving")
            assert told(manager, until="WATCHDOG=1")
        finally:
            process.kill()
            process.communicate()


@pytest.mark.parametrize("watchdog_s", [None, 0.3])
def test_a_socket_that_was_full_at_the_start_gets_to_know_that_the_service_is_ready(monkeypatch, tmp_path, watchdog_s):
    """It was told once: a service that published was ended after a minute and a half, and started again, and so on."""
    monkeypatch.setattr(notify, "SEND_S", 0.05)
    monkeypatch.setattr(notify, "AGAIN_S", 0.05)
    with listening(monkeypatch, str(tmp_path / "notify"), watchdog_s) as manager:
        fill(tmp_path / "notify")
        with told_ready("working", dict):
            assert told(manager, "READY=1\nSTATUS=working")[0] == "STATUS=of another service"
            assert watchdog_s is None or told(manager, "WATCHDOG=1")
        assert told(manager)[-1] == "STOPPING=1"


def test_processes_that_a_service_starts_are_none_themselves(monkeypatch):
    variables = {"NOTIFY_SOCKET": "/run/x", "WATCHDOG_USEC": "3000000", "WATCHDOG_PID": str(os.getpid()), "HOME": "/"}
    assert Manager.of(variables).every_s == 1.0
    assert variables == {"HOME": "/"}
    assert Manager.of({"NOTIFY_SOCKET": "/run/x", "WATCHDOG_USEC": "3000000", "WATCHDOG_PID": "1"}).every_s is None


@pytest.mark.parametrize("limit", ["", "0", "-1", "soon", "9" * 5000])
def test_a_limit_that_is_none_is_passed_over(limit):
    assert Manager.of({"NOTIFY_SOCKET": "/run/x", "WATCHDOG_USEC": limit}).every_s is None


def test_a_manager_that_is_gone_costs_a_line_in_the_log(caplog, tmp_path):
    gone = Manager(str(Path(tmp_path) / "gone"))
    for _ in range(3):
        gone.alive()
    (record,) = caplog.records
    assert "does not receive notifications" in record.getMessage()
