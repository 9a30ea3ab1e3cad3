"""Who may do what, on real links with real certificates and passwords: what is forbidden does not get through."""

from __future__ import annotations

import time

import pytest

from lidarcodec.transport import Endpoints, party_of
from lidarcodec.transport.base import Priority
from lidarcodec.transport.keys import StreamKeys
from tests.transport.secured import CAR, OTHER, QUIET_S, Secured, answering
from tests.transport.test_contract import comes, eventually

pytest.importorskip("cryptography")
pytestmark = pytest.mark.timeout(120)


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


def test_a_configuration_knows_whom_it_is_for(secured):
    assert party_of(Endpoints.of(config=secured.folder / "vehicle-car-7.json5")) == ("vehicle", "car-7")
    assert party_of(Endpoints()) is None
