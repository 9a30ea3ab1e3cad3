"""Who steers a publisher: whoever proves that it receives, and nobody who only says so."""

from __future__ import annotations

import logging
import time

import pytest

from lidarcodec.apps.publisher.followed import FORGET_S, LISTED, MAX_RECEIVERS, UNPROVED_S
from lidarcodec.apps.publisher.path_times import LIMIT_S
from lidarcodec.apps.publisher.proofs import PROOFS, REFUSED
from lidarcodec.apps.publisher.publisher import Publisher
from lidarcodec.apps.publisher.status import MAX_REPORTS
from lidarcodec.apps.publisher.under_way import REMEMBERED
from lidarcodec.apps.reports import Arrival, pack_arrival
from lidarcodec.transport.base import Priority
from lidarcodec.transport.keys import StreamKeys
from lidarcodec.wire import checksum_of, unpack
from tests.apps.flights import Clock, Path, checksum
from tests.apps.in_memory import live, publisher
from tests.apps.streams import Loop
from tests.transport.test_contract import eventually

KEYS = StreamKeys()


@pytest.fixture
def flight():
    """A flight whose honest receiver has proved itself."""
    made = Path(clock=Clock())
    made.came("honest")
    made.put(0)
    made.told("honest", 0)
    return made


def served(flight, messages: int, **took_s: float) -> None:
    """Messages at 10 Hz that receivers report so long after they were put."""
    clock, first = flight._clock, 1000 + int(10 * flight._clock.now)
    for index in range(first, first + messages):
        flight.put(index)
        begin = clock.now
        for name, after_s in sorted(took_s.items(), key=lambda one: one[1]):
            clock.now = begin + after_s
            flight.told(name, index)
        clock.now = begin + 0.1


def test_whoever_shows_no_token_does_not_count(flight):
    flight.put(1)
    flight.told("stranger", 1)
    assert flight.following == "honest"
    assert "stranger" not in flight.receivers
    assert flight.refused["no_token"] == 1


@pytest.mark.parametrize("proof", [None, 0, checksum(1) ^ 1, checksum(2)])
def test_whoever_does_not_know_the_checksum_does_not_count(flight, proof):
    flight.came("server")
    flight.put(1)
    flight.reported("server", 1, proof)
    assert flight.following == "honest"
    assert not flight.wait(0)
    assert flight.refused["wrong_checksum"] == 1


def test_an_index_that_was_not_sent_or_was_reported_before_does_not_count(flight):
    flight.came("server")
    for index in (1, 2**64 - 1):
        flight.told("server", index)
    assert flight.refused["not_sent"] == 2
    flight.put(1)
    flight.told("honest", 1)
    for _ in range(3):
        flight.told("honest", 1)
    assert flight.refused["repeated"] == 3
    assert len(flight._followed["honest"].took_s) == 2, "a report again says nothing of how quick somebody is"


def test_a_report_of_long_ago_does_not_count(flight):
    flight.came("server")
    for index in range(1, PROOFS + 2):
        flight.put(index)
        flight.told("honest", index)
    flight.told("server", 1)
    assert flight.refused["not_sent"] == 1
    flight.told("server", 3)
    assert flight.following == "server"


def test_a_server_that_never_reports_is_not_followed_while_somebody_else_does(flight):
    flight.came("server")
    for index in range(1, 20):
        flight.put(index)
        flight.told("honest", index)
        assert flight.wait(0)
    assert flight.following == "honest"
    assert flight.timeouts == 0


def test_whoever_only_shows_a_token_holds_up_nobody_for_long():
    """Receivers of other makers may neither show a token nor report: nothing waits for their sake."""
    clock = Clock()
    flight = Path(clock=clock)
    flight.came("silent")
    begin = clock.now
    for index in range(100):
        flight.put(index)
        while not flight.wait(0):
            clock.now += 0.1
    assert clock.now - begin <= UNPROVED_S + 2 * LIMIT_S


def test_whoever_reported_once_and_never_again_is_waited_for_only_a_while(flight):
    begin = flight._clock.now
    for index in range(1, 100):
        flight.put(index)
        while not flight.wait(0):
            flight._clock.now += 0.1
    assert flight._clock.now - begin <= FORGET_S + 2 * LIMIT_S
    assert flight.following is None
    flight.told("honest", 99)
    assert flight.following == "honest"


def test_a_viewer_that_is_slow_or_says_so_holds_up_nobody_else():
    clock = Clock()
    flight = Path(clock=clock)
    for name in ("slow", "quick"):
        flight.came(name)
    served(flight, 1, slow=0.4, quick=0.5)
    assert flight.following == "slow"
    served(flight, 10, slow=0.6, quick=0.02)
    state = flight.state()
    assert (state["following"], state["because"]) == ("quick", "quickest")
    served(flight, 10, slow=0.6, quick=0.02)
    assert flight.following == "quick"


def test_equals_do_not_take_each_others_place(flight):
    flight.came("other")
    served(flight, 50, honest=0.05, other=0.03)
    assert (flight.following, flight.switches) == ("honest", 1)
    assert flight.state()["because"] == "first"


def test_the_server_is_followed_though_others_are_quicker_and_the_log_says_so(flight, caplog):
    served(flight, 10, honest=0.02)
    flight.came("server")
    with caplog.at_level(logging.WARNING):
        for _ in range(3):
            served(flight, 10, honest=0.02, server=0.5)
    state = flight.state()
    assert (state["following"], state["because"]) == ("server", "server")
    assert state["for_s"] > 1.0
    (line,) = caplog.messages
    assert "server" in line
    assert "follow=honest" in line
    flight.follow("honest")
    assert (flight.following, flight.state()["because"]) == ("honest", "follow")


def test_on_one_machine_a_server_that_is_clearly_slower_than_others_is_not_followed():
    """No path is slow there, and its name is anybody's."""
    flight = Path(clock=Clock(), slow_server=False)
    flight.came("honest")
    flight.came("server")
    served(flight, 10, honest=0.02, server=0.04)
    assert flight.following == "server"
    served(flight, 10, honest=0.02, server=0.6)
    assert (flight.following, flight.state()["because"]) == ("honest", "quickest")
    served(flight, 10, honest=0.02, server=0.04)
    assert flight.following == "server"


def test_a_round_trip_is_no_longer_than_the_quickest_report_took(flight):
    """Else a receiver that claims a long one has more in flight, and the path looks as if it carried anything."""
    flight.round_trip("honest", 9.0)
    served(flight, 10, honest=0.05)
    assert flight.window <= 2
    assert all(landing.rtt_s <= 0.05 for landing in flight.landings())


def test_a_farm_of_names_displaces_nobody_who_receives(flight):
    for number in range(5 * MAX_RECEIVERS):
        flight.came(f"farm-{number}")
        flight.told(f"farm-{number}", 0) if number % 2 else flight.reported(f"farm-{number}", number, 0)
    flight.came("late")
    served(flight, 1, honest=0.01)
    assert flight.following == "honest"
    assert flight.state()["turned_away"] > 0 or "late" in flight._followed
    assert len(flight._followed._known) <= MAX_RECEIVERS
    assert len(flight.receivers) <= LISTED
    flight.came("server")
    served(flight, 1, honest=0.01, server=0.02)
    assert flight.following == "server", "who is preferred always finds room"
    for index in range(10_000, 10_100):
        flight.put(index)
    assert flight.state()["in_flight"] <= REMEMBERED
    assert len(flight._proofs) <= PROOFS


def test_names_that_prove_nothing_give_way_to_those_that_may():
    flight = Path(clock=Clock())
    for number in range(2 * MAX_RECEIVERS):
        flight.came(f"farm-{number}")
    flight.came("honest")
    served(flight, 1, honest=0.01)
    assert flight.following == "honest"


def test_the_status_says_what_did_not_count(network):
    with publisher(network) as car, live(network) as stream:
        assert stream.next(60)
        state = car.status()["flight"]
        assert set(state["refused"]) == set(REFUSED)
        assert state["because"] == "first"


class Liar:
    """Receives, and reports what it wants."""

    def __init__(self, end, name: str, *, token: bool = True) -> None:
        self.inbox, self._arrivals = end.inbox(KEYS.frame), end.sender(KEYS.arrived(name), Priority.REAL_TIME)
        self._token = end.token(KEYS.arrived(name)) if token else None

    def say(self, index: int, proof: int) -> None:
        self._arrivals.put(pack_arrival(Arrival(index, time.time_ns(), 0, proof)))


def test_a_receiver_that_guesses_is_not_followed_and_one_that_receives_is(network):
    with Publisher(Loop(), transport=network.end(), rate=40.0) as car, live(network, receiver="honest") as stream:
        assert stream.next(60)
        liar = Liar(network.end(), "server")
        for index in range(2000):
            liar.say(index, index)
        assert eventually(lambda: sum(car.status()["flight"]["refused"].values()) >= 200)
        assert car.status()["flight"]["following"] == "honest"

        def received() -> bool:
            data = liar.inbox.receive()
            liar.say(unpack(data).frame_index, checksum_of(data))
            return car.status()["flight"]["following"] == "server"

        assert eventually(received)


def test_reports_under_many_names_do_not_displace_those_of_whom_receives(network):
    with Publisher(Loop(), transport=network.end(), rate=40.0) as car, live(network, receiver="honest") as stream:
        assert stream.next(60)
        assert eventually(lambda: "honest" in car.status()["reports"])
        end = network.end()
        tokens = [end.token(KEYS.arrived(f"farm-{number}")) for number in range(4 * MAX_REPORTS)]
        senders = [end.sender(KEYS.report(f"farm-{number}"), Priority.STATUS) for number in range(6 * MAX_REPORTS)]

        def full() -> bool:  # of two put within a millisecond one may be lost: all are put again
            for sender in senders:
                sender.put(b'{"frames": 1}')
            return len(car.status()["reports"]) == MAX_REPORTS

        assert eventually(full)
        reports = car.status()["reports"]
        assert "honest" in reports
        assert not set(reports) & {f"farm-{number}" for number in range(4 * MAX_REPORTS, 6 * MAX_REPORTS)}
        for token in tokens:
            token.close()
