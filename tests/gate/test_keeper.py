"""What the gate lets in, holds and ends, with a server of our own in Zenoh's place and a clock that we set."""

from __future__ import annotations

import contextlib
import socket
import time
from collections.abc import Callable, Iterator

import pytest

from lidarcodec.gate.addresses import MOST, Addresses, address_of
from lidarcodec.gate.keeper import Keeper
from lidarcodec.gate.limits import Limits
from tests.gate.strangers import HELLO
from tests.gate.test_records import record

ANSWER, SAYS = record(23, b"a" * 100), record(23, b"c" * 50)


class Port:
    """A gate in this thread, and a socket that stands for Zenoh's listener."""

    def __init__(self, limits: Limits) -> None:
        self.now_s = 0.0
        self.zenoh = socket.create_server(("127.0.0.1", 0), backlog=200)
        self.zenoh.settimeout(5)
        self.listener = socket.create_server(("127.0.0.1", 0), backlog=200)
        where = [(self.listener, self.zenoh.getsockname()[1])]
        self.keeper = Keeper(where, limits, lambda: self.now_s)
        self._held = contextlib.ExitStack()

    def stranger(self, host: str = "127.0.0.2", says: bytes = b"") -> socket.socket:
        where = self.listener.getsockname()
        one = self._held.enter_context(socket.create_connection(where, 5, source_address=(host, 0)))
        one.sendall(says)
        one.settimeout(5)
        return one

    def run(self, until: Callable[[], bool], limit_s: float = 5.0) -> bool:
        """Run the gate until something holds."""
        end_s = time.monotonic() + limit_s
        while not until() and time.monotonic() < end_s:
            self.keeper.run_once(0.01)
        return until()

    def is_(self, **state: int) -> bool:
        """Run until its state is so."""
        told = lambda: {name: self.keeper.state()[name] for name in state}  # noqa: E731
        assert self.run(lambda: told() == state), (told(), state)
        return True

    def refused(self, cause: str, count: int) -> bool:
        assert self.run(lambda: self.keeper.refused[cause] == count), self.keeper.refused
        return True

    def accepted(self) -> tuple[socket.socket, tuple[str, int]]:
        """Zenoh's end of the next connection, and the address of the other end."""
        one, where = self.zenoh.accept()
        self._held.enter_context(one).settimeout(5)
        return one, where

    def session(self, host: str = "127.0.0.2") -> tuple[socket.socket, socket.socket]:
        """A client and Zenoh's end, with a session."""
        before = self.keeper.state()["open"]
        found = self.begun(host)
        self.is_(open=before + 1)
        return found

    def begun(self, host: str = "127.0.0.2", turns: int = 3) -> tuple[socket.socket, socket.socket]:
        """The same after so many answers; three seem to be a session."""
        client = self.stranger(host, HELLO)
        shaking = len(self.keeper._shaking)
        assert self.run(lambda: len(self.keeper._shaking) > shaking)
        inner = list(self.keeper._shaking.values())[-1]._inner
        assert inner is not None
        end, where = self.accepted()
        while where != inner.getsockname():
            end, where = self.accepted()
        end.sendall(ANSWER)
        self.through(end, client, len(ANSWER))
        for _ in range(turns):
            client.sendall(SAYS)
            end.sendall(b"")
            assert self.run(lambda: bool(self._waiting(end)))
            end.recv(4096)
            end.sendall(ANSWER)
            self.through(end, client, len(ANSWER))
        return client, end

    def through(self, _: socket.socket, reader: socket.socket, size: int) -> bytes:
        """Bytes that arrive at the other end."""
        got = b""
        while len(got) < size:
            assert self.run(lambda: bool(self._waiting(reader)))
            got += reader.recv(65536)
        return got

    @staticmethod
    def _waiting(one: socket.socket) -> bytes:
        one.setblocking(False)
        try:
            return one.recv(1, socket.MSG_PEEK)
        except BlockingIOError:
            return b""
        finally:
            one.settimeout(5)

    @staticmethod
    def has_ended(one: socket.socket) -> bool:
        """Whether the other end has closed, and nothing is left to read."""
        one.setblocking(False)
        try:
            return not one.recv(4096)
        except BlockingIOError:
            return False
        except ConnectionResetError:
            return True

    def close(self) -> None:
        self._held.close()
        self.keeper.close()
        self.listener.close()
        self.zenoh.close()


@pytest.fixture
def port() -> Iterator[Callable[..., Port]]:
    """Function that opens a gate with limits of its own."""
    opened: list[Port] = []

    def opening(**limits: float) -> Port:
        opened.append(Port(Limits(**limits)))  # type: ignore[arg-type]
        return opened[-1]

    yield opening
    for one in opened:
        one.close()


def test_bytes_pass_both_ways_unchanged_and_an_end_is_passed_on(port: Callable[..., Port]) -> None:
    gate = port()
    client, end = gate.session()
    sent = bytes(range(256)) * 2000
    client.setblocking(False)
    at, got = 0, b""
    while len(got) < len(sent):
        with contextlib.suppress(BlockingIOError):
            at += client.send(sent[at : at + 65536])
        gate.keeper.run_once(0.01)
        with contextlib.suppress(BlockingIOError):
            end.setblocking(False)
            got += end.recv(65536)
    assert got[-len(sent) :] == sent
    client.close()
    gate.run(lambda: False, 0.1)
    end.settimeout(5)
    assert end.recv(1) == b""
    end.close()
    gate.is_(open=0, unfinished=0)


def test_what_is_no_tls_never_reaches_zenoh(port: Callable[..., Port]) -> None:
    gate = port()
    gate.stranger(says=b"GET / HTTP/1.1\r\n\r\n")
    assert gate.refused("not_tls", 1)
    gate.zenoh.settimeout(0.05)
    with pytest.raises(TimeoutError):
        gate.zenoh.accept()


def test_who_says_nothing_is_ended_after_a_while(port: Callable[..., Port]) -> None:
    gate = port()
    silent = gate.stranger(says=HELLO[:40])
    gate.is_(unfinished=1)
    gate.now_s = 4.9
    gate.run(lambda: False, 0.1)
    gate.is_(unfinished=1)
    gate.now_s = 5.3
    assert gate.refused("no_hello", 1)
    with pytest.raises(ConnectionResetError):
        silent.recv(1)


def test_a_handshake_that_does_not_end_is_ended_and_counts_as_failed(port: Callable[..., Port]) -> None:
    gate = port()
    gate.stranger(says=HELLO)
    assert gate.run(lambda: len(gate.keeper._shaking) == 1)
    end, _ = gate.accepted()
    gate.now_s = 8.5
    assert gate.refused("late", 1)
    assert gate.keeper.state()["failed"] == 1
    assert end.recv(4096) == HELLO
    with pytest.raises(ConnectionResetError):
        end.recv(1)


def test_the_newest_of_an_address_pushes_its_oldest_out_and_no_other(port: Callable[..., Port]) -> None:
    gate = port(unfinished_address=3)
    other = gate.stranger("127.0.0.3")
    oldest, *rest = [gate.stranger() for _ in range(4)]
    gate.refused("too_many_unfinished", 1)
    gate.is_(unfinished=4)
    with pytest.raises(ConnectionResetError):
        oldest.recv(1)
    for one in (other, *rest):
        assert not gate._waiting(one)


def test_where_all_is_taken_the_address_with_most_gives_way(port: Callable[..., Port]) -> None:
    gate = port(unfinished=4)
    oldest, *_ = [gate.stranger() for _ in range(3)]
    gate.stranger("127.0.0.3")
    gate.is_(unfinished=4)
    gate.stranger("127.0.0.4")
    gate.refused("too_many_unfinished", 1)
    with pytest.raises(ConnectionResetError):
        oldest.recv(1)


def test_an_address_whose_handshakes_fail_is_barred_for_a_while(port: Callable[..., Port]) -> None:
    gate = port(bar_after=3)
    for number in range(1, 4):
        stranger = gate.stranger(says=HELLO)
        assert gate.run(lambda: len(gate.keeper._shaking) == 1)
        stranger.close()
        assert gate.run(lambda number=number: gate.keeper.state()["failed"] == number)  # type: ignore[misc]
    assert gate.keeper.state()["barred"] == 1
    assert gate.keeper.last_barred == "127.0.0.2"
    gate.stranger(says=HELLO)
    gate.refused("barred", 1)
    gate.session("127.0.0.3")
    gate.now_s = 31.0
    gate.session("127.0.0.2")


def test_handshakes_that_may_fail_come_to_zenoh_few_at_a_time_and_known_addresses_first(
    port: Callable[..., Port],
) -> None:
    gate = port(failing_burst=4, failing_rate=1, mutual=True)
    gate.session("127.0.0.9")
    for number in range(10, 20):
        gate.stranger(f"127.0.0.{number}", HELLO)
    gate.is_(waiting=6)
    gate.session("127.0.0.9")
    gate.is_(waiting=6)
    gate.now_s = 1.0
    gate.is_(waiting=5)
    gate.now_s = 1.3
    assert gate.refused("no_turn", 5)


def test_of_those_who_wait_the_network_that_had_least_goes_first(port: Callable[..., Port]) -> None:
    gate = port(failing_burst=2, failing_rate=1, wait_s=5)
    for number in range(10, 16):
        gate.stranger(f"127.0.1.{number}", HELLO)
    gate.is_(waiting=4)
    gate.stranger("127.0.2.1", HELLO)
    gate.is_(waiting=5)
    gate.now_s = 0.5
    gate.stranger("127.0.1.99", HELLO)
    gate.is_(waiting=6)
    gate.now_s = 1.3
    gate.is_(waiting=5)
    assert [one.address.name for one in gate.keeper._shaking.values()][2:] == ["127.0.2.1"]


def test_connections_that_are_with_zenoh_stay_below_its_limit(port: Callable[..., Port]) -> None:
    gate = port(pending=3, failing_burst=50, at_once=50)
    for number in range(5):
        gate.stranger(says=HELLO)
        gate.is_(unfinished=number + 1)
    gate.is_(waiting=2)
    gate.stranger("127.0.0.3", HELLO)
    gate.refused("no_session", 1)
    gate.is_(waiting=2)


@pytest.mark.parametrize("mutual", [False, True])
def test_where_clients_have_certificates_an_address_is_known_after_a_handshake(
    port: Callable[..., Port], mutual: bool
) -> None:
    gate = port(mutual=mutual)
    client = gate.stranger(says=HELLO)
    assert gate.run(lambda: len(gate.keeper._shaking) == 1)
    end, _ = gate.accepted()
    end.sendall(ANSWER)
    gate.through(end, client, len(ANSWER))
    client.sendall(SAYS)
    gate.through(client, end, len(HELLO) + len(SAYS))
    end.sendall(ANSWER)
    gate.through(end, client, len(ANSWER))
    assert gate.keeper._addresses.seen("127.0.0.2", 0.0).known(0.0) is mutual


def test_without_certificates_a_session_is_sure_only_when_it_has_stood(port: Callable[..., Port]) -> None:
    """What refuses a wrong password looks like a session from outside."""
    gate = port()
    client, end = gate.session()
    assert gate.keeper.state()["sessions"] == 0
    end.close()
    client.close()
    gate.is_(open=0)
    address = gate.keeper._addresses.seen("127.0.0.2", 0.0)
    assert not address.known(0.0)
    gate.session()
    gate.now_s = 15.3
    gate.is_(sessions=1, open=1)
    assert address.known(gate.now_s)


@pytest.mark.parametrize("turns", [1, 3])
def test_an_address_whose_passwords_are_wrong_is_barred(port: Callable[..., Port], turns: int) -> None:
    """Zenoh ends its connections, before or after it seems to have a session."""
    gate = port(bar_after=3)
    for number in range(1, 4):
        client, end = gate.begun(turns=turns)
        end.close()
        assert gate.run(lambda one=client: gate.has_ended(one))
        client.close()
        gate.is_(failed=number)
    gate.is_(barred=1, open=0, unfinished=0)
    gate.stranger()
    gate.refused("barred", 1)


def test_clients_that_leave_by_themselves_have_no_wrong_password(port: Callable[..., Port]) -> None:
    gate = port(bar_after=3)
    for _ in range(6):
        client, end = gate.begun(turns=3)
        client.close()
        gate.is_(open=1)
        end.close()
        gate.is_(open=0)
    gate.is_(failed=0, barred=0)
    _, end = gate.begun(turns=3)
    gate.now_s = 15.3
    gate.is_(sessions=1)
    end.close()
    gate.is_(failed=0)


def test_strangers_that_wait_keep_nobody_out_who_had_a_session(port: Callable[..., Port]) -> None:
    """Addresses of many networks fill all places with a ClientHello each; who is known gets one, and keeps it."""
    gate = port(unfinished=6, failing_burst=1, failing_rate=0.001, mutual=True)
    gate.session("127.0.9.9")
    strangers = [gate.stranger(f"127.{number}.0.1", HELLO) for number in range(1, 8)]
    gate.is_(unfinished=6, waiting=5)
    known = gate.stranger("127.0.9.9")
    gate.refused("too_many_unfinished", 2)
    strangers += [gate.stranger(f"127.{number}.0.1", HELLO) for number in range(11, 20)]
    gate.refused("too_many_unfinished", 11)
    known.sendall(HELLO)
    assert gate.run(lambda: any(one.address.name == "127.0.9.9" for one in gate.keeper._shaking.values()))


@pytest.mark.parametrize("host", ["127.0.9.9", "127.8.0.1"])
def test_strangers_that_are_with_zenoh_give_way_to_who_is_known_and_to_networks_that_have_less(
    port: Callable[..., Port], host: str
) -> None:
    gate = port(pending=3, failing_burst=50, mutual=True)
    gate.session("127.0.9.9")
    networks = ["127.1.0.1", "127.2.0.1", "127.3.0.1"] if host == "127.0.9.9" else [f"127.1.0.{n}" for n in (1, 2, 3)]
    for number, one in enumerate(networks, 1):
        gate.stranger(one, HELLO)
        gate.is_(unfinished=number, waiting=0)
    gate.stranger(host, HELLO)
    gate.refused("no_session", 1)
    gate.is_(unfinished=3, waiting=0)


def test_new_connections_of_an_address_have_a_rate(port: Callable[..., Port]) -> None:
    gate = port(new_burst=5)
    for _ in range(8):
        gate.stranger()
    gate.refused("too_many_new", 3)


def test_a_port_behind_which_nobody_listens_bars_nobody(port: Callable[..., Port]) -> None:
    gate = port(bar_after=1)
    gate.zenoh.close()
    gate.stranger(says=HELLO)
    gate.refused("unreachable", 1)
    assert gate.keeper.state()["failed"] == 0


def test_a_reader_that_stops_holds_only_its_own_buffers(port: Callable[..., Port]) -> None:
    """The sender is held up, so that what is newer can replace what waits there."""
    gate = port()
    client, end = gate.session()
    client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    end.setblocking(False)
    sent, still = 0, 0
    while still < 20:
        gate.run(lambda: False, 0.005)
        try:
            sent += end.send(bytes(65536))
            still = 0
        except BlockingIOError:
            still += 1
    passage = next(iter(gate.keeper._open.values()))
    assert sum(len(way.held) for way in passage._ways) <= 65536
    end.close()
    gate.run(lambda: False, 0.3)
    for gate.now_s in (1.0, 10.0, 17.0):
        gate.run(lambda: False, 0.02)
    gate.is_(open=0)


def test_remembered_addresses_are_bounded_and_those_with_a_connection_stay() -> None:
    addresses = Addresses(Limits())
    kept = addresses.seen("192.0.2.1", 0.0)
    kept.unfinished = 1
    for number in range(MOST + 10):
        addresses.seen(f"10.0.{number // 250}.{number % 250}", 0.0)
    assert len(addresses._found) == MOST
    assert addresses.seen("192.0.2.1", 0.0) is kept


def test_one_subscriber_is_one_address() -> None:
    assert address_of("2001:db8:1:2:3::4") == address_of("2001:db8:1:2:ffff::") != address_of("2001:db8:1:3::4")
    assert address_of("::ffff:192.0.2.7") == "192.0.2.7"
