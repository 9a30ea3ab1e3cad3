"""The rules hold on every kind of link: without a router, over two routers, and the open router carries a stream."""

from __future__ import annotations

import json
import time

import pytest

from lidarcodec.transport import Endpoints, open_transport
from lidarcodec.transport.base import Priority
from tests.conftest import ROOT
from tests.transport.conftest import free_port
from tests.transport.router import Router
from tests.transport.secured import CAR, OTHER, QUIET_S, answering, deployment
from tests.transport.test_contract import comes, eventually

pytest.importorskip("cryptography")
pytestmark = pytest.mark.timeout(120)


def test_rules_hold_on_a_vehicle_that_is_connected_to_directly(tmp_path):
    port = deployment(tmp_path, routers=(), vehicles=("car-7@localhost",))
    where = f"tls/localhost:{port}"
    car = open_transport(Endpoints.of(config=tmp_path / "vehicle-car-7.json5", listen=where))
    anna, olga = (
        open_transport(Endpoints.of(config=tmp_path / f"{who}.json5")) for who in ("viewer-anna", "operator-olga")
    )
    try:
        asked, heard = [], []
        answering(car, CAR, asked)
        inbox = anna.inbox(CAR.frame)
        car.listen(CAR.arrived(), lambda key, data: heard.append(key))
        sender = car.sender(CAR.frame, Priority.FRAMES)
        assert eventually(lambda: sender.matching)
        assert comes(sender, b"frame", lambda: inbox.receive_now() == b"frame")
        assert eventually(lambda: olga.ask(CAR.control_set, b"{}", 2.0) == b"yes")
        assert anna.ask(CAR.control_set, b"{}", 1.0) is None
        own, forged = (anna.sender(CAR.arrived(name), Priority.REAL_TIME) for name in ("anna", "olga"))
        assert eventually(lambda: own.matching)

        def own_is_heard():  # said again: behind what is forged the first may find the link taken, and be dropped
            forged.put(b"x")
            own.put(b"x")
            return heard

        assert eventually(own_is_heard)
        time.sleep(QUIET_S)
        assert set(heard) == {CAR.arrived("anna")}
        assert asked == ["set"]
    finally:
        for one in (anna, olga, car):
            one.close()


@pytest.mark.parametrize("auth", ["certificate", "password"])
def test_a_vehicle_that_keeps_no_rules_speaks_for_no_other_where_there_is_no_router(tmp_path, auth):
    port, other = free_port(), free_port()
    deployment(tmp_path, auth, routers=(), vehicles=("car-7@localhost", "car-8@127.0.0.1"), port=port)
    evil = json.loads((tmp_path / "vehicle-car-8.json5").read_text().partition("\n")[2])
    evil["access_control"] = {"enabled": False}
    (tmp_path / "evil.json5").write_text(json.dumps(evil))
    where = [f"tls/localhost:{port}", f"tls/127.0.0.1:{other}"]

    def opened(name: str, **endpoints):
        return open_transport(Endpoints.of(config=tmp_path / f"{name}.json5", **endpoints))

    car, liar = opened("vehicle-car-7", listen=where[0]), opened("evil", listen=where[1])
    anna, olga = opened("viewer-anna", connect=where), opened("operator-olga", connect=where)
    try:
        heard, alive, asked, lied = [], [], [], []
        for keys in (CAR, OTHER):
            anna.listen(keys.frame, lambda key, data: heard.append(data))
        anna.watch("lidarcodec/v1/*/*/alive", lambda key, there: alive.append(key))
        answering(liar, CAR, lied)
        answering(liar, OTHER, asked)
        liar.token(CAR.alive)
        liar.token(OTHER.alive)
        senders = [(end.sender(keys.frame, Priority.FRAMES), data) for end, keys, data in (
            (car, CAR, b"true"), (liar, CAR, b"false"), (liar, OTHER, b"own"))]  # fmt: skip

        def own_frames_come():
            for sender, data in senders:
                sender.put(data)
            return {b"true", b"own"} <= set(heard)

        assert eventually(own_frames_come)
        assert eventually(lambda: olga.ask(OTHER.control_set, b"{}", 2.0) == b"yes")
        assert olga.ask(CAR.control_set, b"{}", 1.0) is None
        own_frames_come()
        time.sleep(QUIET_S)
        assert set(heard) == {b"true", b"own"}
        assert (set(alive), set(asked), lied) == ({OTHER.alive}, {"set"}, [])
    finally:
        for one in (anna, olga, liar, car):
            one.close()


def test_two_routers_carry_what_one_does(tmp_path):
    """A vehicle at one router, a viewer at the other; both routers hold the rules."""
    ports = free_port(), free_port()
    deployment(tmp_path, routers=("localhost", "127.0.0.1"), port=ports[0])
    at = [f"tls/localhost:{port}" for port in ports]
    hub = Router(config=str(tmp_path / "router-localhost.json5"), listen=at[0])
    far = Router(config=str(tmp_path / "router-127.0.0.1.json5"), listen=at[1], connect=at[0])
    car = open_transport(Endpoints.of(config=tmp_path / "vehicle-car-7.json5", connect=at[0]))
    anna = open_transport(Endpoints.of(config=tmp_path / "viewer-anna.json5", connect=at[1]))
    try:
        inbox, asked = anna.inbox(CAR.frame), []
        answering(car, CAR, asked)
        sender = car.sender(CAR.frame, Priority.FRAMES)
        assert eventually(lambda: sender.matching)
        assert comes(sender, b"frame", lambda: inbox.receive_now() == b"frame")
        assert eventually(lambda: anna.ask(CAR.control_keyframe, b"{}", 2.0) == b"yes")
        assert anna.ask(CAR.control_set, b"{}", 1.0) is None
        assert asked == ["keyframe"]
    finally:
        for one in (car, anna):
            one.close()
        far.kill()
        hub.kill()


def test_the_router_that_is_shipped_for_a_trusted_network_carries_a_stream():
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    router = Router(config=str(ROOT / "packaging" / "zenoh-router.json5"), listen=endpoint)
    car, anna = (open_transport(Endpoints.of(connect=endpoint)) for _ in range(2))
    try:
        inbox = anna.inbox(CAR.frame)
        sender = car.sender(CAR.frame, Priority.FRAMES)
        assert eventually(lambda: sender.matching)
        sender.put(bytes(150_000))
        assert inbox.receive() == bytes(150_000)
    finally:
        for one in (car, anna):
            one.close()
        router.kill()
