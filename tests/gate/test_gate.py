"""Strangers at the TLS port of a vehicle that listens: real Zenoh, real certificates, as users start it."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from lidarcodec.commands.certs import command as certs
from lidarcodec.errors import TransportError
from lidarcodec.gate.gate import Gate, listener_at
from lidarcodec.transport import Endpoints, open_transport
from lidarcodec.transport.gated import put_behind
from tests.conftest import ROOT
from tests.gate.strangers import NOBODY
from tests.transport.conftest import free_port
from tests.transport.test_contract import eventually

pytest.importorskip("cryptography")
ELSEWHERE = "127.0.0.2"


class Car:
    """A vehicle that listens, in this process, and the files of those who connect."""

    def __init__(self, folder: Path, host: str = "127.0.0.1", auth: str = "certificate") -> None:
        self.folder, self.port = folder / "d", free_port()
        certs.run(
            self.folder,
            vehicles=[f"car-7@{host}"],
            viewers=["anna"],
            operators=["olga"],
            auth=auth,
            port=self.port,
            days=365,
        )
        self.transport = open_transport(Endpoints.of(config=self.folder / "vehicle-car-7.json5"))

    def viewer_s(self, limit_s: float = 60.0) -> float:
        """Seconds until a viewer is in."""
        begun_s = time.monotonic()
        with open_transport(Endpoints.of(config=self.folder / "viewer-anna.json5")) as viewer:
            assert eventually(lambda: viewer.connected == 1, limit_s), self.gate
            return time.monotonic() - begun_s

    @property
    def gate(self) -> dict[str, Any]:
        state = self.transport.gate()
        assert state is not None
        return state

    def counts(self, **least: int) -> bool:
        """Whether what is refused comes to so many within a few seconds."""
        return eventually(lambda: all(self.gate.get("refused", {}).get(name, 0) >= least[name] for name in least))


@contextlib.contextmanager
def strangers(kind: str, port: int, count: int, source: str = ELSEWHERE) -> Iterator[None]:
    words = [sys.executable, "-m", "tests.gate.strangers", kind, str(port), str(count), source]
    process = subprocess.Popen(words, cwd=ROOT)
    try:
        yield
    finally:
        process.kill()
        process.wait()


@pytest.fixture
def car(tmp_path: Path) -> Iterator[Car]:
    one = Car(tmp_path)
    yield one
    one.transport.close()


def open_files() -> int:
    return sum(1 for _ in Path("/proc/self/fd").iterdir())


def test_idle_connections_and_broken_handshakes_keep_nobody_out(car: Car) -> None:
    """Zenoh alone lets nobody in for minutes: it ends ten of either kind a second."""
    before = open_files()
    with strangers("idle", car.port, 150), strangers("abort", car.port, 40, "127.0.0.3"):
        assert car.counts(barred=20, too_many_unfinished=50)
        assert car.viewer_s() < 30.0
        assert open_files() < before + 40
    assert car.gate["failed"] < 40
    assert car.gate["last_barred"] == "127.0.0.3"


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("kind", "count", "source"),
    [
        ("idle", 2000, "*"),
        ("idle", 2000, ELSEWHERE),
        ("garbage", 100, "127.0.0.1"),
        ("abort", 40, "127.1.0.*"),
        ("abort", 15, "*"),
        ("nobody", 20, ELSEWHERE),
        ("nobody", 15, "*"),
    ],
)
def test_no_kind_of_stranger_keeps_anybody_out(car: Car, kind: str, count: int, source: str) -> None:
    before = open_files()
    with strangers(kind, car.port, count, source):
        time.sleep(6.0)
        for _ in range(2):
            assert car.viewer_s(60.0) < (60.0 if source == "*" else 30.0)
        assert open_files() < before + 120


@pytest.mark.sweep
def test_who_had_a_session_gets_in_again_though_strangers_share_the_address(car: Car) -> None:
    with open_transport(Endpoints.of(config=car.folder / "viewer-anna.json5")):
        assert eventually(lambda: car.gate["sessions"] == 1)
    with strangers("abort", car.port, 40, "127.0.0.1"):
        assert car.counts(barred=50)
        assert car.viewer_s(90.0)


def test_a_link_through_the_gate_carries_messages_after_the_gate_was_killed(car: Car) -> None:
    with open_transport(Endpoints.of(config=car.folder / "viewer-anna.json5")) as viewer:
        car.transport.answer("lidarcodec/v1/car-7/lidar/control/get", lambda data: b"yes")
        asked = lambda: viewer.ask("lidarcodec/v1/car-7/lidar/control/get", b"{}", 1.0) == b"yes"  # noqa: E731
        assert eventually(asked)
        gate = car.transport._gate  # type: ignore[attr-defined]
        os.kill(gate._process.pid, signal.SIGKILL)
        assert eventually(lambda: car.gate["restarts"] == 1 and car.gate["running"])
        assert eventually(asked)


def test_ipv4_and_ipv6_come_through_one_gate(car: Car) -> None:
    """An IPv6 address as such is no server name for Zenoh's client, so a stranger stands for one."""
    try:
        one = socket.create_connection(("::1", car.port), 5)
    except OSError:
        pytest.skip("needs IPv6")
    with one, contextlib.suppress(OSError), NOBODY.wrap_socket(one) as encrypted:
        encrypted.sendall(b"hello")
        while encrypted.recv(100):
            pass
    assert eventually(lambda: car.gate["failed"] == 1)
    assert car.viewer_s() < 30.0


def test_a_gate_ends_with_its_program_and_gives_the_port_back(tmp_path: Path) -> None:
    port = free_port()
    gate = Gate([(listener_at("127.0.0.1", port), 1)])
    process = gate._process
    gate.close()
    gate.close()
    assert process.returncode == 0
    listener_at("127.0.0.1", port).close()


def test_a_gate_ends_when_its_program_is_killed(tmp_path: Path) -> None:
    program = (
        "from lidarcodec.gate.gate import Gate, listener_at\n"
        "import sys, time\n"
        "gate = Gate([(listener_at('127.0.0.1', int(sys.argv[1])), 1)])\n"
        "print(gate._process.pid, flush=True)\n"
        "time.sleep(60)\n"
    )
    port = free_port()
    words = [sys.executable, "-c", program, str(port)]
    with subprocess.Popen(words, cwd=ROOT, stdout=subprocess.PIPE, text=True) as started:
        assert started.stdout is not None
        assert int(started.stdout.readline())
        started.kill()
    assert eventually(lambda: _refuses(port))


def _refuses(port: int) -> bool:
    try:
        socket.create_connection(("127.0.0.1", port), 1).close()
    except OSError:
        return True
    return False


def test_an_address_that_is_taken_is_an_error_in_one_line() -> None:
    with (
        socket.create_server(("127.0.0.1", 0)) as taken,
        pytest.raises(TransportError, match=r"cannot listen on 127\.0\.0\.1 port"),
    ):
        listener_at("127.0.0.1", taken.getsockname()[1])


def options(**changed: Any) -> Any:
    given = {"mode": "peer", "listen/endpoints": ["tls/127.0.0.1:0"], "scouting/gossip/enabled": False} | changed
    return given.get


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"scouting/gossip/enabled": True}, "gossip is on"),
        ({"scouting/gossip/enabled": {"peer": True, "router": False}}, "gossip is on"),
        ({"listen/endpoints": ["tls/0.0.0.0:0#iface=eth0"]}, "interface"),
        ({"access_control/subjects": [{"id": "a", "interfaces": ["eth0"]}]}, "interface"),
    ],
)
def test_where_zenoh_must_listen_itself_it_does_and_that_is_logged(
    changed: dict[str, Any], says: str, caplog: pytest.LogCaptureFixture
) -> None:
    assert put_behind(options(**changed)) == (None, {})
    assert says in caplog.text


@pytest.mark.parametrize("endpoints", [[], ["tcp/127.0.0.1:0"], None, {"router": ["tls/127.0.0.1:0"]}])
def test_without_a_tls_port_there_is_no_gate(endpoints: Any) -> None:
    assert put_behind(options(**{"listen/endpoints": endpoints})) == (None, {})


def test_a_gate_can_be_switched_off(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LIDARCODEC_GATE", "off")
    assert put_behind(options()) == (None, {})
    monkeypatch.setenv("LIDARCODEC_GATE", "maybe")
    with pytest.raises(TransportError, match="LIDARCODEC_GATE must be on or off"):
        put_behind(options())


def test_zenoh_listens_on_loopback_behind_it_with_the_options_of_its_endpoint() -> None:
    listens = {"peer": ["tcp/127.0.0.1:9", "tls/127.0.0.1:0#so_sndbuf=65536"]}
    gate, behind = put_behind(options(**{"listen/endpoints": listens}))
    assert gate is not None
    gate.close()
    first, second = behind["listen/endpoints"]
    assert first == "tcp/127.0.0.1:9"
    assert second.startswith("tls/127.0.0.1:")
    assert second.endswith("#so_sndbuf=65536")
    assert json.dumps(behind)


def test_wrong_passwords_bar_an_address(tmp_path: Path) -> None:
    """Zenoh ends the session of such a client, which tries again and again."""
    car = Car(tmp_path, auth="password")
    try:
        wrong = tmp_path / "wrong.json5"
        wrong.write_text((car.folder / "viewer-anna.json5").read_text().replace('"password": "', '"password": "not-'))
        with open_transport(Endpoints.of(config=wrong)) as stranger:
            assert eventually(lambda: car.gate["barred"] == 1), car.gate
            assert stranger.connected == 0
        assert car.gate["sessions"] == 0
    finally:
        car.transport.close()
