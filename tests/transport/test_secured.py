"""Who may do what, on real links with real certificates and passwords: what is forbidden does not get through."""

from __future__ import annotations

import json
import shutil
import threading
import time
from pathlib import Path

import pytest

from lidarcodec.commands.certs import command as certs
from lidarcodec.errors import TransportError
from lidarcodec.transport import Endpoints, open_transport, party_of
from lidarcodec.transport.base import Priority
from lidarcodec.transport.keys import StreamKeys
from tests.conftest import ROOT
from tests.transport.conftest import free_port
from tests.transport.router import Router
from tests.transport.test_contract import comes, eventually

pytest.importorskip("cryptography")
pytestmark = pytest.mark.timeout(120)
CAR, OTHER = StreamKeys("car-7", "roof"), StreamKeys("car-8", "roof")
QUIET_S = 0.5
"""How long something forbidden has to stay away, after what is allowed came through on the same links."""


def deployment(folder, auth="certificate", routers=("localhost",), vehicles=("car-7", "car-8"), port=None, days=365):
    """A folder of configurations, and the port in them."""
    port = port or free_port()
    people = {"vehicles": vehicles, "viewers": ["anna", "ben"], "operators": ["olga"]}
    certs.run(folder, routers=routers, **people, auth=auth, port=port, days=days)
    return port


class Secured:
    """A deployment with its router running; sessions are opened by the name of their file."""

    def __init__(self, folder: Path, auth: str) -> None:
        self.folder, self.auth = folder, auth
        self.port = deployment(folder, auth)
        self.endpoint = f"tls/localhost:{self.port}"
        self.router = Router(config=str(folder / "router-localhost.json5"), listen=self.endpoint)
        self.opened = []

    def open(self, name: str):
        self.opened.append(open_transport(Endpoints.of(config=self.folder / f"{name}.json5")))
        return self.opened[-1]

    def close(self) -> None:
        for one in self.opened:
            one.close()
        self.router.kill()


@pytest.fixture(scope="module", params=["certificate", "password"])
def secured(request, tmp_path_factory):
    """A deployment whose people are known by certificate, then one in which they are known by password."""
    made = Secured(tmp_path_factory.mktemp(request.param), request.param)
    yield made
    made.close()


@pytest.fixture
def people(secured):
    """Function that opens a session by name; closed after the test."""
    before = len(secured.opened)
    yield secured.open
    for one in secured.opened[before:]:
        one.close()


def answering(car, keys, asked):
    """Have a vehicle answer its controls; `asked` gets the last part of each key that was."""
    for key in (
        keys.control_get,
        keys.control_set,
        keys.control_reset,
        keys.control_keyframe,
        keys.past,
        keys.past_mark,
    ):
        car.answer(key, lambda data, key=key: asked.append(key.rpartition("/")[2]) or b"yes")


def test_a_vehicle_and_a_viewer_do_all_they_have_to(people):
    car, anna, olga = people("vehicle-car-7"), people("viewer-anna"), people("operator-olga")
    seen, asked, receivers, heard = [], [], [], []
    anna.watch("lidarcodec/v1/*/*/alive", lambda key, alive: seen.append((key, alive)))
    anna.listen(CAR.status, lambda key, data: heard.append(data))
    anna.listen(CAR.refine(), lambda key, data: heard.append(data))
    inbox = anna.inbox(CAR.frame)
    answering(car, CAR, asked)
    car.watch(CAR.arrived(), lambda key, alive: receivers.append(key))
    car.listen(CAR.arrived(), lambda key, data: heard.append(data))
    car.listen(CAR.report(), lambda key, data: heard.append(data))
    car.listen(CAR.refined(), lambda key, data: heard.append(data))
    car.listen(CAR.pose(), lambda key, data: heard.append(data))
    anna.listen(CAR.pose(), lambda key, data: heard.append(b"pose for anna"))
    anna.listen(CAR.odometry, lambda key, data: heard.append(data))
    token = car.token(CAR.alive)
    frames, status = car.sender(CAR.frame, Priority.FRAMES), car.sender(CAR.status, Priority.STATUS)
    arrived = anna.sender(CAR.arrived("anna"), Priority.REAL_TIME)
    report = anna.sender(CAR.report("anna"), Priority.STATUS)
    refine, refined = car.sender(CAR.refine(3), Priority.BESIDE), anna.sender(CAR.refined("anna"), Priority.REAL_TIME)
    pose, odometry = olga.sender(CAR.pose("olga"), Priority.STATUS), car.sender(CAR.odometry, Priority.STATUS)
    anna.token(CAR.arrived("anna"))
    for sender, data in (
        (frames, b"frame"), (status, b"status"), (arrived, b"arrived"), (report, b"report"), (pose, b"pose"),
        (odometry, b"odometry"), (refine, b"sector"), (refined, b"refined"),
    ):  # fmt: skip
        assert eventually(lambda sender=sender: sender.matching), data
        arrived = {
            b"frame": lambda: inbox.receive_now() == b"frame",
            b"pose": lambda: {b"pose", b"pose for anna"} <= set(heard),
        }
        assert comes(sender, data, arrived.get(data, lambda data=data: data in heard)), (data, heard)
    told = {b"status", b"arrived", b"report", b"pose", b"pose for anna", b"odometry", b"sector", b"refined"}
    assert set(heard) == told
    assert eventually(lambda: receivers == [CAR.arrived("anna")])
    assert eventually(lambda: seen == [(CAR.alive, True)])
    asks = ((anna, CAR.control_get), (anna, CAR.control_keyframe), (olga, CAR.control_set), (olga, CAR.control_reset))
    for who, key in (*asks, (olga, CAR.past), (olga, CAR.past_mark)):
        assert eventually(lambda who=who, key=key: who.ask(key, b"{}", 2.0) == b"yes"), key
    token.close()
    assert eventually(lambda: seen[-1] == (CAR.alive, False))


def test_a_vehicle_publishes_under_its_own_name_only(secured, people):
    car, other, anna = people("vehicle-car-7"), people("vehicle-car-8"), people("viewer-anna")
    heard, alive = [], []
    for keys in (CAR, OTHER):
        anna.listen(keys.frame, lambda key, data: heard.append((key, data)))
        anna.listen(keys.status, lambda key, data: heard.append((key, data)))
    anna.watch("lidarcodec/v1/*/*/alive", lambda key, here: alive.append(key))
    spied = []
    car.listen(OTHER.frame, lambda key, data: spied.append(data))
    true = other.sender(OTHER.frame, Priority.FRAMES)
    forged = [car.sender(key, Priority.STATUS) for key in (OTHER.frame, OTHER.status)]
    car.token(OTHER.alive)
    own = car.sender(CAR.frame, Priority.FRAMES)
    assert eventually(lambda: own.matching and true.matching)
    for sender in forged:
        sender.put(b"forged")

    def both_are_heard():  # said again: the first may go to the car's ears only, before the viewer's are known
        true.put(b"true")
        own.put(b"true")
        return {(CAR.frame, b"true"), (OTHER.frame, b"true")} <= set(heard)

    assert eventually(both_are_heard), heard
    time.sleep(QUIET_S)
    assert {data for _, data in heard} == {b"true"}
    assert not alive
    assert not spied

    def denied():
        lines = secured.router.log.splitlines()
        return any("unauthorized to Put" in line and OTHER.frame in line and "car-7" in line for line in lines)

    assert eventually(denied)


def test_a_viewer_changes_nothing_and_speaks_for_nobody_else(people):
    car, anna, ben = people("vehicle-car-7"), people("viewer-anna"), people("viewer-ben")
    asked, heard, receivers = [], [], []
    answering(car, CAR, asked)
    for key in (CAR.arrived(), CAR.report(), CAR.pose(), CAR.odometry):
        car.listen(key, lambda key, data: heard.append((key, data)))
    car.watch(CAR.arrived(), lambda key, alive: receivers.append(key))
    ben.listen(CAR.frame, lambda key, data: heard.append((key, data)))
    assert eventually(lambda: anna.ask(CAR.control_get, b"{}", 2.0) == b"yes")
    for key in (CAR.control_set, CAR.control_reset, CAR.past, CAR.past_mark):
        assert anna.ask(key, b"{}", 0.5) is None
    own = anna.sender(CAR.arrived("anna"), Priority.REAL_TIME)
    assert eventually(lambda: own.matching)
    for key in (
        CAR.frame,
        CAR.status,
        CAR.arrived("ben"),
        CAR.report("ben"),
        CAR.pose("ben"),
        CAR.pose("anna"),
        CAR.odometry,
        CAR.arrived("server"),
    ):
        anna.sender(key, Priority.STATUS).put(b"forged")
    anna.token(CAR.arrived("ben"))
    anna.token(CAR.alive)
    assert comes(own, b"true", lambda: heard)
    time.sleep(QUIET_S)
    assert set(heard) == {(CAR.arrived("anna"), b"true")}
    assert not receivers
    assert not {"set", "past", "mark"} & set(asked)


def test_an_operator_plays_recordings_as_vehicles_of_their_own_and_as_no_other(people):
    olga, anna = people("operator-olga"), people("viewer-anna")
    heard = []
    anna.listen("lidarcodec/v1/*/*/frame", lambda key, data: heard.append(key))
    played, forged = (olga.sender(keys.frame, Priority.STATUS) for keys in (StreamKeys("playback-7", "roof"), CAR))
    assert eventually(lambda: played.matching)
    forged.put(b"forged")
    assert comes(played, b"played", lambda: heard)
    time.sleep(QUIET_S)
    assert set(heard) == {"lidarcodec/v1/playback-7/roof/frame"}


def test_everybody_asks_for_maps_and_only_operators_serve_them(people):
    olga, car, anna = people("operator-olga"), people("vehicle-car-7"), people("viewer-anna")
    maps, tile = "lidarcodec/v1/@maps/**", "lidarcodec/v1/@maps/town/3/-2"
    for who in (car, anna):
        who.answer_under(maps, lambda key, data: b"forged")
    olga.answer_under(maps, lambda key, data: b"true")
    for who in (car, anna):
        assert eventually(lambda who=who: who.ask(tile, b"{}", 2.0) == b"true")
        assert who.ask_all(tile, b"{}", 20.0) == [b"true"]


def test_a_wildcard_beyond_what_is_allowed_gets_nothing(people):
    """The trap of containment: somebody who subscribes to everything is told nothing and gets nothing."""
    car, anna = people("vehicle-car-7"), people("viewer-anna")
    everything, frames = [], []
    anna.listen("lidarcodec/v1/**", lambda key, data: everything.append(key))
    ben = people("viewer-ben")
    ben.listen("lidarcodec/v1/*/*/frame", lambda key, data: frames.append(key))
    sender = car.sender(CAR.frame, Priority.FRAMES)
    assert eventually(lambda: sender.matching)
    assert comes(sender, b"frame", lambda: frames)
    assert set(frames) == {CAR.frame}
    time.sleep(QUIET_S)
    assert not everything


def refused(path: Path, change=lambda tls, auth: None) -> None:
    """Nobody gets in with this configuration, changed in its TLS and user settings; it is tried until it is stopped."""
    config = json.loads(path.read_text().partition("\n")[2])
    change(config["transport"]["link"]["tls"], config["transport"].get("auth", {}).get("usrpwd", {}))
    changed = path.with_name("changed.json5")
    changed.write_text(json.dumps(config))
    stop = threading.Event()
    threading.Timer(0.8, stop.set).start()
    with pytest.raises(TransportError, match="stopped"):
        open_transport(Endpoints.of(config=changed), stop=stop).close()
    changed.unlink()


def says(secured: Secured, reason: str, act) -> None:
    """The router's log gives the reason for what is done."""
    before = len(secured.router.log)
    act()
    assert eventually(lambda: reason in secured.router.log[before:]), secured.router.log[before:]


def foreign(folder: Path, made: Secured) -> Path:
    """Anna's file of another deployment, whose authority nobody here knows."""
    other = folder / "other"
    other.mkdir()
    deployment(other, made.auth, port=made.port)
    return other / "viewer-anna.json5"


def foreign_but_trusting(folder: Path, made: Secured) -> None:
    """Who trusts this deployment, with a certificate of another."""
    own = json.loads(anna(made).read_text().partition("\n")[2])["transport"]["link"]["tls"]
    key = "root_ca_certificate_base64"
    refused(foreign(folder, made), lambda tls, auth: tls.update({key: own[key]}))


def without_certificate(tls: dict, auth: dict) -> None:
    del tls["connect_certificate_base64"], tls["connect_private_key_base64"]
    tls["enable_mtls"] = False


def anna(made: Secured) -> Path:
    return made.folder / "viewer-anna.json5"


STRANGERS = [
    ("certificate", "UnknownCA", lambda folder, made: refused(foreign(folder, made))),
    ("certificate", "UnknownIssuer", foreign_but_trusting),
    ("certificate", "peer sent no certificates", lambda folder, made: refused(anna(made), without_certificate)),
    ("password", "UnknownCA", lambda folder, made: refused(foreign(folder, made))),
    ("password", "Invalid password", lambda _, made: refused(anna(made), lambda _, auth: auth.update(password="x"))),
    ("password", "Invalid user", lambda _, made: refused(anna(made), lambda _, auth: auth.update(user="nobody"))),
    ("password", "UsrPwd", lambda _, made: refused(anna(made), lambda _, auth: auth.clear())),
]


@pytest.mark.parametrize(("auth", "reason", "tried"), STRANGERS)
def test_strangers_do_not_get_in_and_the_router_says_why(tmp_path, caplog, auth, reason, tried):
    """Each with a router of its own, because an address that fails a few times is barred."""
    (tmp_path / "own").mkdir()
    made = Secured(tmp_path / "own", auth)
    try:
        tried(tmp_path, made)
        assert eventually(lambda: reason in made.router.log), made.router.log
        assert "again until it works" in caplog.text
    finally:
        made.close()


def test_who_was_removed_may_do_nothing_any_more(tmp_path):
    made = Secured(tmp_path, "certificate")
    try:
        kept = tmp_path / "kept.json5"
        shutil.copy(tmp_path / "viewer-anna.json5", kept)
        certs.run(tmp_path, remove=["anna"], days=30)
        assert not (tmp_path / "viewer-anna.json5").exists()
        made.router.kill()
        made.router = Router(config=str(tmp_path / "router-localhost.json5"), listen=made.endpoint)
        made.opened.append(anna := open_transport(Endpoints.of(config=kept)))
        car, ben = made.open("vehicle-car-7"), made.open("viewer-ben")
        removed, heard = [], []
        anna.listen(CAR.frame, lambda key, data: removed.append(data))
        ben.listen(CAR.frame, lambda key, data: heard.append(data))
        sender = car.sender(CAR.frame, Priority.FRAMES)
        assert eventually(lambda: sender.matching)
        assert comes(sender, b"frame", lambda: heard)
        time.sleep(QUIET_S)
        assert not removed
    finally:
        made.close()


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


def test_a_configuration_knows_whom_it_is_for(secured):
    assert party_of(Endpoints.of(config=secured.folder / "vehicle-car-7.json5")) == ("vehicle", "car-7")
    assert party_of(Endpoints()) is None


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
