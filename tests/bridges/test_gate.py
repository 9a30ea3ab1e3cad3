"""Viewers of a bridge are counted: otherwise those that do not read take any amount of memory, and hold up its end."""

from __future__ import annotations

import contextlib
import signal
import socket
import threading

import pytest

from lidarcodec.apps.publisher.publisher import Publisher
from lidarcodec.bridges import gate as gates
from lidarcodec.bridges.gate import Gate
from lidarcodec.bridges.origins import Origins
from lidarcodec.errors import SettingsError
from tests.apps.streams import Loop
from tests.command_line import start
from tests.transport.conftest import free_port
from tests.transport.test_contract import eventually

LIMIT_S = 120.0
pytestmark = pytest.mark.timeout(400)


@pytest.fixture
def server():
    """A server that answers the first bytes of each connection by sending without end."""
    listener = socket.create_server(("127.0.0.1", 0))
    stop = threading.Event()

    def serve(one: socket.socket) -> None:
        with one, contextlib.suppress(OSError):
            one.setblocking(True)
            asked = one.recv(100)
            while asked and not stop.is_set():
                one.sendall(bytes(65536))
                with contextlib.suppress(BlockingIOError):
                    while one.recv(65536, socket.MSG_DONTWAIT):
                        pass

    def take() -> None:
        with contextlib.suppress(OSError):
            while True:
                threading.Thread(target=serve, args=(listener.accept()[0],), daemon=True).start()

    threading.Thread(target=take, daemon=True).start()
    yield listener.getsockname()
    stop.set()
    listener.close()


@pytest.fixture
def gate(server):
    """Function that opens a gate to that server."""
    opened = []

    def begin(most: int) -> Gate:
        one = Gate("127.0.0.1", 0, most)
        opened.append(one)
        one.listen()
        one.open(server)
        return one

    yield begin
    for one in opened:
        one.close()


def viewer(one: Gate, address: str = "127.0.0.1", says: bytes = b"GET / HTTP/1.1\r\n\r\n") -> socket.socket:
    """A connection that has asked for something."""
    made = socket.create_connection(("127.0.0.1", one.port), 10.0, source_address=(address, 0))
    made.sendall(says)
    return made


def is_in(one: socket.socket, size: int = 100) -> bool:
    """Whether it gets what the server sends, so many bytes of it."""
    with contextlib.suppress(OSError):
        return one.recv(size, socket.MSG_WAITALL) == bytes(size)
    return False


def test_viewers_have_a_limit_in_all_and_for_one_address_and_the_first_refused_one_is_said(gate, caplog):
    one = gate(4)
    with contextlib.ExitStack() as held:
        first = [held.enter_context(viewer(one)) for _ in range(2)]
        assert [is_in(each) for each in first] == [True, True]
        assert not is_in(held.enter_context(viewer(one))), "half of them"
        others = [held.enter_context(viewer(one, "127.0.0.2")) for _ in range(2)]
        assert [is_in(each) for each in others] == [True, True]
        for _ in range(20):
            assert not is_in(held.enter_context(viewer(one, "127.0.0.3"))), "all of them"
        assert one.counts == {"viewers": 4, "refused": 21}
        (said,) = [line for line in caplog.messages if "refused" in line]
        assert "127.0.0.1" in said
        others[0].close()

        def again() -> bool:
            return is_in(held.enter_context(viewer(one, "127.0.0.3")))

        assert eventually(again)


def test_a_viewer_that_asks_for_nothing_or_takes_nothing_is_ended(gate, monkeypatch, caplog):
    monkeypatch.setattr(gates, "BEGIN_S", 1.0)
    monkeypatch.setattr(gates, "LAG_S", 1.0)
    one = gate(6)
    with viewer(one) as stuck, viewer(one) as quick, socket.create_connection(("127.0.0.1", one.port), 10.0) as quiet:
        assert eventually(lambda: (is_in(quick, 2**20), one.counts["ended"] == 2)[1])
        assert is_in(quick)
        for gone in (quiet, stuck):
            with pytest.raises(OSError, match="reset"):
                list(iter(lambda one=gone: one.recv(2**20), b""))
    assert len([line for line in caplog.messages if "ended a viewer" in line]) == 1


PAGES = {
    "https://app.foxglove.dev": True,
    "http://localhost:8080": True,
    "http://[::1]:80": True,
    "http://10.0.0.5:3000": True,
    "https://own.example": True,
    "file://": True,
    "https://news.example": False,
    "https://app.foxglove.dev.news.example": False,
    "https://app.foxglove.dev:444": False,
    "http://10.0.0.6": False,
    "null": False,
    "": False,
}


def test_a_web_page_from_elsewhere_is_no_viewer(server, caplog):
    """A browser lets any page connect to this machine: each could read the clouds and the way of the vehicle."""
    one = Gate("127.0.0.1", 0, 4, Origins(["https://own.example"]).refusal)
    one.listen()
    one.open(server)
    try:
        for origin, may in PAGES.items():
            head = f"GET / HTTP/1.1\r\nHost: 10.0.0.5:8765\r\noRiGin: {origin}\r\n\r\n".encode()
            with viewer(one, says=head) as page:
                assert is_in(page) == may, origin
        both = b"GET / HTTP/1.1\r\nOrigin: http://localhost\r\nOrigin: https://news.example\r\n\r\n"
        with viewer(one, says=both) as page:
            assert page.recv(100).startswith(b"HTTP/1.1 403 ")
    finally:
        one.close()
    (said,) = [line for line in caplog.messages if "refused" in line]
    assert "https://news.example" in said


@pytest.mark.parametrize("wrong", ["news.example", "https://", "https://a/b", "ftp://a", "*"])
def test_what_is_no_origin_is_refused(wrong):
    with pytest.raises(SettingsError, match="is no origin"):
        Origins([wrong])


def test_a_viewer_that_sends_too_much_is_ended(gate):
    """Foxglove's server keeps a message of up to 64 MB for each viewer until all of it is there."""
    one = gate(2)
    with viewer(one) as talks:
        talks.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 2**16)  # so that what was sent was nearly all taken
        sent = 0
        with contextlib.suppress(ConnectionError):
            for sent in range(100):
                talks.sendall(bytes(2**16))
                assert sent >= 15 or is_in(talks)
    assert eventually(lambda: one.counts["ended"] == 1)
    assert 15 <= sent < 99


def test_where_frames_are_large_viewers_that_do_not_read_give_way(gate):
    """Four frames wait for each, of 30 MB or of 2: memory was bounded by frames, not by bytes."""
    one = gate(6)
    with contextlib.ExitStack() as stack:
        idle = [stack.enter_context(viewer(one, f"127.0.0.{1 + number % 2}")) for number in range(5)]
        eventually(lambda: all(seen.waits_since_s is not None for seen in one._viewers) and len(one._viewers) == 5)
        reads = stack.enter_context(viewer(one, "127.0.0.3"))
        assert is_in(reads)
        stop = threading.Event()

        def read() -> None:
            while not stop.is_set() and reads.recv(1 << 20):
                pass

        thread = threading.Thread(target=read)
        thread.start()
        one.make_room(2)
        eventually(lambda: one.counts["ended"] == 4)
        stop.set()
        thread.join(10.0)
        assert is_in(reads)
        assert len(one._viewers) == 2
        with viewer(one, "127.0.0.4") as late:
            assert not is_in(late)
        del idle


def test_room_for_viewers_is_counted_in_bytes(network, monkeypatch):
    foxglove = pytest.importorskip("foxglove")
    from lidarcodec.bridges import foxglove as bridges
    from tests.bridges.test_foxglove import Viewer

    del foxglove
    monkeypatch.setattr(bridges, "VIEWER_BYTES", 1 << 20)  # a cloud of these frames has more
    with (
        bridges.FoxgloveBridge(["vehicle/lidar"], port=0, transport=network(), max_viewers=8) as bridge,
        Publisher(Loop(whole=True), rate=5.0, transport=network()),
    ):
        viewers = [Viewer(bridge.url) for _ in range(4)]
        for one in viewers:
            one.wait_for("/vehicle/lidar/points")
        viewers[0].subscribe("/vehicle/lidar/points")
        eventually(lambda: bridge.gate.counts["ended"] == 4 - bridges.LEAST_VIEWERS, LIMIT_S)


def test_a_name_that_is_none_is_reported():
    from lidarcodec.errors import TransportError

    with pytest.raises(TransportError, match=r"cannot listen on no-such-host\.invalid:0: this host does not exist"):
        Gate("no-such-host.invalid", 0).listen()


def test_the_bridge_refuses_viewers_beyond_its_limit(network):
    foxglove = pytest.importorskip("tests.bridges.test_foxglove", reason="serves Foxglove (extra `bridges`)")
    with foxglove.FoxgloveBridge(["car-7/roof"], port=0, transport=network(), max_viewers=2) as bridge:
        first = foxglove.Viewer(bridge.url)
        first.wait_for("/car-7/roof/points")
        with socket.create_connection((bridge.host, bridge.port), 10.0) as second:
            assert second.recv(100).startswith(b"HTTP/1.1 503 ")
        assert bridge.summary()["refused"] == 1
        first.close()


@pytest.mark.sweep
def test_the_command_ends_although_a_viewer_does_not_read():
    foxglove = pytest.importorskip("tests.bridges.test_foxglove", reason="serves Foxglove (extra `bridges`)")
    from lidarcodec.transport import Endpoints

    port = free_port()
    command = start("bridge", "foxglove", "vehicle/lidar", "--port", 0, "--connect", f"tcp/127.0.0.1:{port}")
    line = command.stderr.readline()
    with Publisher(Loop(whole=True), rate=10.0, endpoints=Endpoints.of(listen=f"tcp/127.0.0.1:{port}")):
        stuck, quick = foxglove.Viewer(line.split()[-1]), foxglove.Viewer(line.split()[-1])
        for each in (stuck, quick):
            each.subscribe("/vehicle/lidar/points")
        quick.messages(15)
        quick.close()
        command.send_signal(signal.SIGTERM)
        _, complained = command.communicate(timeout=60)
    assert command.returncode == 0, complained
    assert "Traceback" not in complained
    stuck.close()
