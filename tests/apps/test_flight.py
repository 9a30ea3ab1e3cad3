"""One message in flight: what bounds latency on a narrow path, with a clock that the test holds."""

from __future__ import annotations

import pytest

from lidarcodec.apps.publisher.path_times import LIMIT_S, NEW_CODEC_MESSAGES
from lidarcodec.apps.publisher.under_way import REMEMBERED
from tests.apps.flights import Clock, Path


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def flight(clock):
    """The messages in flight to one receiver."""
    one = Path(clock=clock)
    one.came("office")
    return one


def test_without_anybody_who_reports_nothing_waits(clock):
    flight = Path(clock=clock)
    for index in range(100):
        assert flight.wait(0)
        flight.put(index)
    assert flight.timeouts == 0


def test_the_next_message_waits_for_the_report_of_the_last(flight):
    assert flight.wait(0)
    flight.put(0)
    assert not flight.wait(0)
    flight.told("office", 0)
    assert flight.wait(0)


def test_a_report_covers_everything_before_it(flight):
    flight.put(0)
    flight.put(3)
    flight.told("office", 3)
    assert flight.wait(0)
    assert flight.state()["in_flight"] == 0


def test_a_silent_receiver_holds_the_stream_up_for_a_second_only(clock, flight):
    flight.put(0)
    clock.now += LIMIT_S + 0.001
    assert flight.wait(0)
    assert flight.timeouts == 1
    flight.put(1)
    assert not flight.wait(0)


def settled(clock, took_s: float, *, size: int = 0, rtt_s: float = 0.0, **options) -> Path:
    """A flight whose receiver has reported often, each time so soon."""
    flight = Path(clock=clock, **options)
    flight.came("server")
    flight.round_trip("server", rtt_s)
    for index in range(10):
        flight.put(index, size)
        clock.now += took_s
        flight.told("server", index)
    return flight


@pytest.mark.parametrize(("took_s", "limit_s"), [(0.01, 0.04), (0.1, 0.13), (0.3, 0.33)])
def test_a_lost_message_holds_the_next_one_up_for_no_longer_than_its_report_takes(clock, took_s, limit_s):
    flight = settled(clock, took_s)
    for index in (10, 11):
        flight.put(index)
        clock.now += limit_s - 0.005
        assert not flight.wait(0.0)
        clock.now += 0.01
        assert flight.wait(0.0)
    assert [one.index for one in flight.given_up()] == [10, 11]
    flight.put(12)
    flight.told("server", 12)
    assert flight.wait(0.0)
    assert flight.unreported == 2


def test_reports_that_come_at_different_times_get_longer(clock):
    flight = settled(clock, 0.01)
    for index in range(10, 26):
        flight.put(index)
        clock.now += 0.01 if index % 2 else 0.09
        flight.told("server", index)
    flight.put(30)
    clock.now += 0.09 + 2 * 0.04 - 0.01
    assert not flight.wait(0.0)
    clock.now += 0.02
    assert flight.wait(0.0)


def test_a_lost_message_starts_no_queue(clock):
    """It may stand in a queue on the path: what follows gets the time that both need there."""
    flight = settled(clock, 0.1, size=100_000)
    flight.put(10, 100_000)
    clock.now += 0.14
    assert flight.wait(0.0)
    flight.put(11, 100_000)
    clock.now += 0.22
    assert not flight.wait(0.0)
    clock.now += 0.02
    assert flight.wait(0.0)


def test_silence_of_a_second_ends_the_haste(clock):
    flight = settled(clock, 0.01)
    for index in range(10, 20):
        assert flight.wait(0.0)
        flight.put(index, 1000)
        clock.now += 0.1
    assert flight.wait(0.0)
    assert [landing.landed for landing in flight.landings()][-1:] == [False]
    flight.put(20)
    clock.now += LIMIT_S - 0.01
    assert not flight.wait(0.0)
    clock.now += 0.02
    assert flight.wait(0.0)


def test_one_lost_message_is_no_silence_however_long_the_next_one_takes_to_come(clock):
    flight = settled(clock, 0.01)
    flight.came("viewer")
    flight.put(10)
    for _ in range(4):
        clock.now += 1.0
        assert flight.wait(0.0)
    flight.put(11)
    assert flight.following == "server"
    clock.now += 0.01
    flight.told("server", 11)
    assert (flight.following, flight.unreported) == ("server", 1)


def test_a_lost_message_says_nothing_about_the_path(clock):
    flight = settled(clock, 0.01)
    flight.landings()
    flight.put(10, 1000)
    clock.now += 0.1
    assert flight.wait(0.0)
    flight.put(11, 1000)
    flight.told("server", 11)
    assert [landing.landed for landing in flight.landings()] == [True]


def test_a_lost_report_is_no_lost_message(clock):
    flight = settled(clock, 0.01)
    flight.put(10)
    clock.now += 0.1
    assert flight.wait(0.0)
    flight.put(11)
    flight.told("server", 11, had=[9, 10])
    assert (flight.unreported, flight.given_up()) == (0, [])


def test_with_several_in_flight_a_report_tells_which_are_missing(clock):
    flight = settled(clock, 0.11, rtt_s=0.1)
    for index in (10, 11, 12):
        assert flight.wait(0.0)
        flight.put(index)
    clock.now += 0.1
    flight.told("server", 11, had=[9])
    assert [one.index for one in flight.given_up()] == [10]
    assert flight.state()["in_flight"] == 1


def test_a_receiver_that_misses_one_message_is_still_followed(clock):
    flight = settled(clock, 0.01)
    flight.came("viewer")
    flight.put(10)
    clock.now += 0.31
    assert flight.wait(0.0)
    assert flight.following == "server"


def test_where_every_message_is_to_arrive_none_is_given_up_early_nor_two_sent_at_once(clock):
    flight = settled(clock, 0.01, limit_s=30.0)
    flight.round_trip("server", 1.0)
    flight.put(10)
    clock.now += 29
    assert not flight.wait(0.0)
    assert flight.following == "server"


def test_a_path_that_needs_long_for_a_message_gets_long(clock, flight):
    for index in range(3):
        flight.put(index)
        clock.now += 0.9
        flight.told("office", index)
    flight.put(3)
    clock.now += 1.5
    assert not flight.wait(0)
    clock.now += 1.3
    assert flight.wait(0)


def test_a_receiver_that_was_killed_is_not_waited_for(flight):
    flight.put(0)
    flight.went("office")
    assert flight.wait(0)
    assert flight.timeouts == 0


@pytest.mark.parametrize(
    ("present", "named", "followed"),
    [
        (["a", "b"], None, "a"),
        (["a", "server"], None, "server"),
        (["a", "b", "server"], "b", "b"),
        (["a"], "b", "a"),
        ([], "b", None),
    ],
)
def test_the_named_one_is_followed_else_the_server_else_the_first(clock, present, named, followed):
    flight = Path(named, clock=clock)
    for name in present:
        flight.came(name)
    assert flight.following == followed


def test_a_slow_viewer_does_not_steer(clock):
    flight = Path(clock=clock)
    flight.came("server")
    flight.came("viewer")
    for index in range(5):
        assert flight.wait(0)
        flight.put(index)
        flight.told("server", index)
    flight.put(5)
    flight.told("viewer", 5)
    assert not flight.wait(0)


def test_a_receiver_that_hangs_is_left_for_one_that_reports_until_it_reports_again(clock):
    flight = Path("hangs", clock=clock)
    flight.came("hangs")
    flight.came("works")
    flight.put(0)
    clock.now += LIMIT_S + 0.001
    assert flight.wait(0)
    assert flight.following == "works"
    flight.put(1)
    flight.told("works", 1)
    assert flight.wait(0)
    flight.told("hangs", 0)
    assert flight.following == "hangs"


def test_whoever_takes_over_does_not_answer_for_what_was_sent_before(clock):
    flight = Path(clock=clock)
    flight.came("viewer")
    flight.put(0)
    assert not flight.wait(0)
    flight.came("server")
    assert flight.wait(0)
    flight.follow("viewer")
    assert flight.following == "viewer"


@pytest.mark.parametrize(("rtt_s", "send_s", "window"), [(0.0, 0.1, 1), (0.1, 0.1, 2), (0.2, 0.1, 3), (0.1, 0.01, 4)])
def test_a_long_round_trip_gets_more_messages_in_flight(clock, flight, rtt_s, send_s, window):
    flight.round_trip("office", rtt_s)
    for index in range(5):
        flight.put(index)
        clock.now += rtt_s + send_s
        flight.told("office", index)
    assert flight.window == window
    for index in range(5, 5 + window):
        assert flight.wait(0)
        flight.put(index)
    assert not flight.wait(0)


def test_the_time_to_send_is_right_with_several_in_flight(clock, flight):
    """Put together, reported 0.1 s apart after a round trip of 0.1 s: the link needs 0.1 s for each."""
    flight.round_trip("office", 0.1)
    begin = clock.now
    reports = []
    for index in range(12):
        clock.now = begin if index < 2 else reports[index - 2]
        flight.put(index)
        reports.append(begin + 0.1 + 0.1 * (index + 1))
        if index >= 1:
            clock.now = reports[index - 1]
            flight.told("office", index - 1)
    assert flight.window == 2


def test_what_each_message_took_is_told_once_without_the_round_trip_and_the_decoder(clock, flight):
    flight.round_trip("office", 0.02)
    flight.put(0, 1000, key=True)
    clock.now += 0.1
    flight.told("office", 0, held_s=0.05)
    (landing,) = flight.landings()
    assert (landing.bits, landing.key, landing.landed) == (8000.0, True, True)
    assert landing.send_s == pytest.approx(0.1 - 0.02 - 0.05)
    assert flight.landings() == []


def test_several_in_flight_share_the_time_that_the_path_was_busy(clock, flight):
    """Put together, they leave one behind the other; the path is not to be taken for half as fast."""
    flight.round_trip("office", 0.1)
    begin = clock.now
    for index in range(3):
        flight.put(index, 1000)
    for index in range(3):
        clock.now = begin + 0.1 + 0.04 * (index + 1)
        flight.told("office", index)
    assert [landing.send_s for landing in flight.landings()] == pytest.approx([0.04] * 3)


def test_a_message_that_was_given_up_says_that_the_path_stands_and_nothing_when_it_arrives_late(clock, flight):
    flight.put(0, 1000)
    clock.now += LIMIT_S + 0.5
    assert flight.wait(0)
    (landing,) = flight.landings()
    assert not landing.landed
    assert landing.send_s == pytest.approx(LIMIT_S + 0.5)
    flight.put(1, 1000)
    clock.now += 0.2
    flight.told("office", 0)  # the stall is over: everything that waited comes at once
    assert flight.landings() == []
    clock.now += 0.01
    flight.told("office", 1)
    (landing,) = flight.landings()
    assert landing.send_s == pytest.approx(0.01)


def test_another_receiver_is_another_path(clock):
    flight = Path(clock=clock)
    flight.came("viewer")
    flight.put(0, 1000)
    before = flight.switches
    flight.came("server")
    assert flight.switches == before + 1
    flight.told("server", 0)
    assert flight.landings() == [], "it may have come in the middle of the message"


def test_a_decoder_that_has_to_be_started_gets_the_time_for_it(clock, flight):
    """Else messages would go on, the receiver would keep only the newest, and miss what it needs."""
    flight.new_codec()
    for index in range(NEW_CODEC_MESSAGES):
        flight.put(index)
        clock.now += 3.0
        assert not flight.wait(0)
        flight.told("office", index)
    flight.put(9)
    clock.now += 10.0
    assert flight.wait(0)


def test_frames_that_the_followed_receiver_did_not_report_though_later_ones_are_counted(clock, flight):
    """Else a message that is lost on the way, or given up and replaced in the receiver's ring, is lost in silence."""
    flight.put(0, frames=8)
    clock.now += LIMIT_S + 0.001
    assert flight.wait(0)
    flight.put(8)
    assert flight.unreported == 0, "it may still arrive"
    flight.told("office", 8)
    assert flight.state()["unreported"] == 8


def test_a_message_that_arrives_late_was_not_lost(clock, flight):
    flight.put(0)
    clock.now += LIMIT_S + 0.001
    assert flight.wait(0)
    flight.put(1)
    flight.told("office", 0)
    flight.told("office", 1)
    assert (flight.timeouts, flight.unreported) == (1, 0)


def test_nobody_answers_for_what_was_sent_to_another(clock):
    flight = Path(clock=clock)
    flight.put(0)  # before anybody was there
    flight.came("viewer")
    flight.put(1)
    flight.came("server")
    flight.put(2)
    flight.told("server", 2)
    assert flight.unreported == 0


def test_what_is_forgotten_without_a_report_is_counted(clock, flight):
    for index in range(REMEMBERED + 3):
        flight.put(index)
        clock.now += LIMIT_S + 0.001
        assert flight.wait(0)
    assert flight.unreported == 3


def test_a_second_message_of_one_frame_waits_whatever_the_window(clock, flight):
    flight.round_trip("office", 0.2)
    for index in range(5):
        flight.put(index)
        clock.now += 0.3
        flight.told("office", index)
    flight.put(5)
    assert flight.wait(0)
    assert not flight.wait(0, most=1)
