"""Processes that come, are killed and come again: what an operator does, and what power does to a vehicle."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
import zenoh

from lidarcodec.errors import TransportError
from lidarcodec.transport import Endpoints, open_transport
from lidarcodec.transport.base import Priority
from tests import forks
from tests.conftest import ROOT
from tests.transport.conftest import free_port
from tests.transport.router import Router
from tests.transport.test_contract import comes, eventually


class Node:
    """A process of tests.transport.node; `seen` holds whom it sees now."""

    def __init__(self, name: str, port: int) -> None:
        command = [sys.executable, "-m", "tests.transport.node", name, str(port)]
        self.process = forks.Process(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
        self.seen: set[str] = set()
        self.ready = threading.Event()
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        for line in self.process.stdout:
            word = line.strip()
            if word == "ready":
                self.ready.set()
            elif word[0] == "+":
                self.seen.add(word[1:])
            elif word[0] == "-":
                self.seen.discard(word[1:])

    def kill(self) -> None:
        self.process.send_signal(signal.SIGKILL)
        self.process.wait(60)
        self._thread.join(5)
        self.process.stdout.close()


def test_processes_find_each_other_whoever_started_first_and_whoever_was_killed():
    port = free_port()
    nodes = {}
    try:
        for name in "abc":
            nodes[name] = Node(name, port)
            assert nodes[name].ready.wait(60)
        for name in "abc":
            assert eventually(lambda name=name: nodes[name].seen == set("abc")), (name, nodes[name].seen)
        nodes.pop("a").kill()  # it kept the meeting point
        for name, other in (("b", "c"), ("c", "b")):
            assert eventually(lambda name=name, other=other: nodes[name].seen == {name, other})
        nodes["d"] = Node("d", port)
        assert eventually(lambda: nodes["d"].seen == set("bcd"))
        assert eventually(lambda: nodes["b"].seen == set("bcd"))
        for name in "bcd":
            nodes.pop(name).kill()
        for name in "ef":
            nodes[name] = Node(name, port)
        assert eventually(lambda: nodes["e"].seen == nodes["f"].seen == set("ef"))
    finally:
        for node in nodes.values():
            node.kill()


def test_many_that_start_at_once_all_meet():
    port = free_port()
    nodes = {name: Node(name, port) for name in "abcd"}
    try:
        for name, node in nodes.items():
            assert eventually(lambda node=node: node.seen == set("abcd")), (name, node.seen)
    finally:
        for node in nodes.values():
            node.kill()


def sees(sender, inbox, word=b"hello"):
    """Whether what is sent arrives."""
    assert eventually(lambda: sender.matching)
    return comes(sender, word, lambda: inbox.receive_now() == word)


def test_a_client_waits_for_its_router_and_comes_back_after_the_router_was_away():
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    opened = []

    def opening():
        opened.append(open_transport(Endpoints.of(connect=endpoint)))

    threads = [threading.Thread(target=opening) for _ in range(2)]
    for thread in threads:
        thread.start()
    time.sleep(0.7)
    assert not opened
    router = open_transport(Endpoints.of(listen=endpoint, mode="router"))
    for thread in threads:
        thread.join(60)
    car, office = opened
    try:
        inbox, sender = office.inbox("s/frame"), car.sender("s/frame", Priority.FRAMES)
        assert sees(sender, inbox)
        router.close()
        assert eventually(lambda: not sender.matching)
        router = open_transport(Endpoints.of(listen=endpoint, mode="router"))
        assert sees(sender, inbox, b"again")
    finally:
        for one in (car, office, router):
            one.close()


def test_waiting_for_a_router_ends_when_it_should():
    stop = threading.Event()
    threading.Timer(0.3, stop.set).start()
    start = time.monotonic()
    with pytest.raises(TransportError):
        open_transport(Endpoints.of(connect=f"tcp/127.0.0.1:{free_port()}"), stop=stop)
    assert time.monotonic() - start < 20


def test_a_whole_configuration_file_is_used_as_it_is(tmp_path):
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    common = {"scouting": {"multicast": {"enabled": False}}, "transport": {"shared_memory": {"enabled": False}}}
    (tmp_path / "car.json5").write_text(
        json.dumps(common | {"mode": "peer", "listen": {"endpoints": [endpoint]}, "connect": {"endpoints": []}})
    )
    (tmp_path / "office.json5").write_text("// a comment\n" + json.dumps(common | {"mode": "client"}))
    with (
        open_transport(Endpoints.of(config=tmp_path / "car.json5")) as car,
        open_transport(Endpoints.of(config=tmp_path / "office.json5", connect=endpoint)) as office,
    ):
        assert sees(car.sender("s/frame", Priority.FRAMES), office.inbox("s/frame"))


SECRET = {
    "auth": {"usrpwd": {"user": "car-7", "password": "secret-123"}},
    "link": {"tx": {"queue": {"size": {"data": 0}}}},
}


@pytest.mark.parametrize("text", ["{", '{"mode": "leaf"}', '{"no_such_key": 1}', json.dumps({"transport": SECRET})])
def test_a_configuration_file_that_is_none_is_refused(tmp_path, text):
    path = tmp_path / "zenoh.json5"
    path.write_text(text)
    with pytest.raises(TransportError, match="not a Zenoh configuration") as refused:
        open_transport(Endpoints.of(config=path))
    assert "secret" not in str(refused.value)


def test_an_address_that_is_not_ours_is_refused():
    with pytest.raises(TransportError, match=r"^cannot listen on tcp/192\.0\.2\.1:7447: "):
        open_transport(Endpoints.of(listen="tcp/192.0.2.1:7447"))


def test_a_port_that_another_program_has_is_refused_in_plain_words():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        place = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(TransportError, match=f"^cannot listen on {place}: another program uses it: end that one"):
            open_transport(Endpoints.of(listen=place))


def test_two_programs_can_share_a_port_only_if_both_are_ours(caplog, monkeypatch):
    monkeypatch.setattr("lidarcodec.transport.meeting_point.ALONE_S", 0.5)
    with socket.socket() as foreign:
        foreign.bind(("127.0.0.1", 0))
        foreign.listen()
        with open_transport(Endpoints(loopback_port=foreign.getsockname()[1])):
            assert eventually(lambda: "choose another loopback port" in caplog.text)


def test_nothing_listens_beyond_the_loopback_address():
    with open_transport(Endpoints(loopback_port=free_port())):
        ours = {_target(entry) for entry in Path("/proc/self/fd").iterdir()}
        addresses = set()
        for table in ("tcp", "tcp6", "udp", "udp6"):
            for line in Path(f"/proc/self/net/{table}").read_text().splitlines()[1:]:
                fields = line.split()
                listens = fields[3] == "0A" or table.startswith("udp")
                if listens and f"socket:[{fields[9]}]" in ours:
                    addresses.add(fields[1].split(":")[0])
        assert addresses == {"0100007F"}


def _target(entry: Path) -> str:
    try:
        return str(entry.readlink())
    except OSError:
        return ""


def test_one_that_listens_and_connects_finds_a_partner_that_comes_later():
    here, there = f"tcp/127.0.0.1:{free_port()}", f"tcp/127.0.0.1:{free_port()}"
    with open_transport(Endpoints.of(listen=here, connect=there)) as early:
        time.sleep(1.0)  # the first attempts fail
        with open_transport(Endpoints.of(listen=there)):
            assert eventually(lambda: early.connected)


def test_processes_meet_when_a_hung_one_that_kept_the_meeting_point_goes_on():
    """A publisher stopped with Ctrl-Z keeps the port and answers nobody; started again it must bring all together."""
    port = free_port()
    nodes = {"a": Node("a", port)}
    try:
        assert nodes["a"].ready.wait(60)
        nodes["a"].process.send_signal(signal.SIGSTOP)
        for name in "bc":
            nodes[name] = Node(name, port)
            assert nodes[name].ready.wait(60)
        time.sleep(1.0)
        nodes["a"].process.send_signal(signal.SIGCONT)
        for name in "abc":
            assert eventually(lambda name=name: nodes[name].seen == set("abc")), (name, nodes[name].seen)
    finally:
        for node in nodes.values():
            node.kill()


def test_when_one_of_two_routers_is_killed_what_went_through_it_goes_through_the_other():
    near, far = (f"tcp/127.0.0.1:{free_port()}" for _ in range(2))
    routers = [Router(listen=near), Router(listen=far, connect=near)]
    car, office = (open_transport(Endpoints.of(connect=(near, far))) for _ in range(2))
    try:
        heard = []
        office.listen("s/x", lambda key, data: heard.append(data))
        sender = car.sender("s/x", Priority.STATUS)

        def comes(word):
            def one():
                sender.put(word)
                return word in heard

            return eventually(one)

        assert comes(b"both")
        routers.pop(0).kill()
        assert comes(b"one")
    finally:
        for one in (car, office):
            one.close()
        for router in routers:
            router.kill()


def peak_mib(process: int) -> int:
    """The most memory that a process had."""
    status = Path(f"/proc/{process}/status").read_text()
    return int(status.partition("VmHWM:")[2].split()[0]) // 1024


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="the peak of a process's memory is read from /proc")
@pytest.mark.parametrize("packaged", [False, True])
def test_what_is_longer_than_any_message_takes_no_memory_of_a_router_and_reaches_nobody(packaged):
    where, key = f"tcp/127.0.0.1:{free_port()}", "lidarcodec/v1/car-7/roof/frame"
    config = str(ROOT / "packaging" / "zenoh-router.json5") if packaged else None
    router = Router(listen=where, config=config) if packaged else Router(listen=where)
    stranger = json.dumps(
        {"mode": "client", "connect": {"endpoints": [where]}, "scouting": {"multicast": {"enabled": False}}}
    )
    session = zenoh.open(zenoh.Config.from_json5(stranger))
    try:
        with open_transport(Endpoints.of(connect=where)) as receiver:
            inbox, block = receiver.inbox(key), zenoh.CongestionControl.BLOCK
            publisher = session.declare_publisher(key, congestion_control=block)
            assert eventually(lambda: publisher.matching_status.matching)
            before = peak_mib(router.process.pid)
            publisher.put(bytes(300 << 20))
            publisher.put(b"the link goes on")
            assert inbox.receive() == b"the link goes on"
            assert peak_mib(router.process.pid) - before < 200
    finally:
        session.close()
        router.kill()
