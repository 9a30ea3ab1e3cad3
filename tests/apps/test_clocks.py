"""Clocks that are apart, drift, and are set: a latency is right, or said to be unknown, and nothing waits."""

from __future__ import annotations

import json
import logging
import threading

import numpy as np
import pytest

from lidarcodec.apps.clocks import Clock, ClockOffset, LatencyClock
from lidarcodec.apps.publisher.publisher import Publisher
from lidarcodec.apps.receiver.freshness import Freshness
from lidarcodec.apps.receiver.live_stream import subscribe
from lidarcodec.apps.receiver.round_trips import AGAIN_S, EVERY_S, RoundTrips
from lidarcodec.transport.memory import MemoryNetwork
from tests.apps.streams import Loop
from tests.transport.test_contract import eventually

MS = 1_000_000


class Host:
    """A machine whose clocks go when told to; `ahead_ns` is how far its wall clock is set ahead of true time."""

    def __init__(self, ahead_ns: int = 0) -> None:
        self.true_s, self.ahead_ns = 1000.0, ahead_ns
        self.clock = Clock(lambda: round(self.true_s * 1e9) + self.ahead_ns, lambda: self.true_s)

    def wait(self, seconds: float) -> None:
        self.true_s += seconds


def ask(clocks: LatencyClock, here: Host, there_ns: int, out_s: float, back_s: float) -> None:
    """A question that needs so long each way to a publisher whose clock is `there_ns` ahead of true time."""
    asked = here.clock.wall_ns()
    here.wait(out_s)
    told = round(here.true_s * 1e9) + there_ns
    here.wait(back_s)
    clocks.answered(asked, told, here.clock.wall_ns())


def test_the_offset_is_within_its_bound_whatever_the_two_ways_take():
    rng = np.random.default_rng(7)
    for _ in range(200):
        offset, true_ms, t = ClockOffset(), float(rng.uniform(-1e5, 1e5)), 0.0
        for _ in range(10):
            out, back = rng.exponential(5.0, 2)
            t += 2.0
            offset.answered(0, round((out + true_ms) * MS), round((out + back) * MS), t)
        assert abs(offset.offset_ms(t) - true_ms) <= offset.bound_ms(t) + 1e-3
        assert offset.bound_ms(t) < 20.0


def test_latency_is_put_right_where_the_clocks_are_surely_apart():
    here = Host(ahead_ns=5_000 * MS)
    clocks = LatencyClock(here.clock)
    assert clocks.state()["state"] == "unknown"
    ask(clocks, here, 0, 0.010, 0.010)
    assert clocks.state() == {"state": "corrected", "offset_ms": -5000.0, "bound_ms": 10.0, "jumps": 0}
    made = round(here.true_s * 1e9)
    here.wait(0.08)
    assert clocks.latency_ms(made, here.clock.wall_ns()) == pytest.approx(80.0, abs=10.1)


def test_clocks_that_agree_as_far_as_can_be_known_are_left_alone():
    here = Host()
    clocks = LatencyClock(here.clock)
    ask(clocks, here, 0, 0.030, 0.001)
    state = clocks.state()
    assert state["state"] == "in step"
    assert abs(state["offset_ms"]) <= state["bound_ms"]
    made = round(here.true_s * 1e9)
    here.wait(0.05)
    assert clocks.latency_ms(made, here.clock.wall_ns()) == pytest.approx(50.0)


@pytest.mark.parametrize("jump_s", [-3600.0, -2.0, 2.0, 10.0, 86_400.0])
def test_our_own_clock_may_be_set_at_any_time(jump_s):
    here = Host()
    clocks = LatencyClock(here.clock)
    ask(clocks, here, 0, 0.001, 0.001)
    for number in range(20):
        made = round(here.true_s * 1e9)
        here.wait(0.05)
        if number == 10:
            here.ahead_ns += round(jump_s * 1e9)
        assert clocks.latency_ms(made, here.clock.wall_ns()) == pytest.approx(50.0, abs=2.0)
        here.wait(0.05)
    assert clocks.state()["jumps"] == 1


@pytest.mark.parametrize("jump_s", [-3600.0, -2.0, 2.0, 10.0, 86_400.0])
def test_the_publishers_clock_may_be_set_at_any_time(jump_s):
    """Until it has told its time again latencies are unknown; they are never wrong by the jump."""
    here, there_ns, asked_for = Host(), 0, []
    clocks = LatencyClock(here.clock, unsure=lambda: asked_for.append(True))
    ask(clocks, here, 0, 0.001, 0.001)
    values = []
    for number in range(20):
        if number == 10:
            there_ns = round(jump_s * 1e9)
        made = round(here.true_s * 1e9) + there_ns
        here.wait(0.05)
        values.append(clocks.latency_ms(made, here.clock.wall_ns()))
        here.wait(0.05)
        if number == 13:
            assert asked_for
            ask(clocks, here, there_ns, 0.001, 0.001)
    assert values[:10] == pytest.approx([50.0] * 10, abs=2.0)
    assert values[10:14] == [None] * 4
    assert values[14:] == pytest.approx([50.0] * 6, abs=2.0)
    assert clocks.state()["jumps"] >= 1


def test_a_stall_is_not_taken_for_a_clock_that_was_set():
    here = Host()
    clocks = LatencyClock(here.clock)
    ask(clocks, here, 0, 0.001, 0.001)
    made = round(here.true_s * 1e9)
    here.wait(0.05)
    clocks.latency_ms(made, here.clock.wall_ns())
    here.wait(9.0)
    assert clocks.latency_ms(made + 100 * MS, here.clock.wall_ns()) == pytest.approx(8950.0, abs=2.0)


def test_another_publisher_has_another_clock():
    here = Host()
    clocks = LatencyClock(here.clock)
    ask(clocks, here, 7000 * MS, 0.001, 0.001)
    clocks.restarted()
    assert clocks.state()["state"] == "unknown"


def test_answers_that_met_a_message_say_little_and_are_asked_again_soon():
    here = Host()
    trips = RoundTrips(here.clock, LatencyClock(here.clock))

    def answer(seconds, **said):
        def ask(question):
            here.wait(seconds)
            return json.dumps(json.loads(question) | said).encode()

        return ask

    trips.ask(answer(0.2, busy=True, time_ns=0))
    assert trips.rtt_ms == pytest.approx(200.0)
    assert trips.due_s <= here.true_s + AGAIN_S
    trips.ask(answer(0.03, busy=False, time_ns=0))
    trips.ask(answer(0.01, busy=True, time_ns=0))
    assert trips.rtt_ms == pytest.approx(30.0)
    for seconds in (0.5, 0.02):
        trips.ask(answer(seconds, busy=False))
    assert trips.rtt_ms == pytest.approx(30.0)
    assert trips.due_s == pytest.approx(here.true_s + EVERY_S, abs=0.1)


@pytest.mark.parametrize("hostile", [b"", b"{", b"[]", b"7", b'{"time_ns": 1e99}', b'{"time_ns": true}', b"[" * 9999])
def test_an_answer_that_is_none_hurts_nobody(hostile):
    here = Host()
    clocks = LatencyClock(here.clock)
    RoundTrips(here.clock, clocks).ask(lambda question: hostile)
    assert clocks.state()["offset_ms"] is None


def test_frames_are_stale_only_while_younger_ones_come():
    fresh = Freshness.of("live", newest=True)
    assert fresh.shows(100, 0.0)
    after_a_stall = [fresh.shows(age, 9.0 + 0.01 * i) for i, age in enumerate((9000, 8000, 5000, 2100, 1900, 100))]
    assert after_a_stall == [False] * 4 + [True] * 2
    assert fresh.shows(None, 10.0), "an age that nobody knows is none"
    slow = [fresh.shows(3000, 20.0 + 0.5 * i) for i in range(6)]
    assert slow == [False, False, True, True, True, True]
    assert Freshness.of("live", newest=False).shows(9000, 0.0), "who wants every frame gets every frame"
    assert not any(Freshness.of(1.0, newest=True).shows(3000, float(now)) for now in range(10))
    assert Freshness.of(None, newest=True).shows(9000, 0.0)


class Jumping:
    """The machine's own clock, set by so many ns."""

    def __init__(self) -> None:
        self.by_ns = 0
        self.clock = Clock(lambda: Clock().wall_ns() + self.by_ns)


@pytest.mark.parametrize("who", ["vehicle", "receiver"])
def test_a_clock_that_is_set_in_mid_stream_freezes_nothing(who, caplog):
    """An hour ahead, then two back: frames go on, none is taken for stale, and latency is right again soon."""
    network, hosts = MemoryNetwork(), {"vehicle": Jumping(), "receiver": Jumping()}
    before = set(threading.enumerate())
    with caplog.at_level(logging.WARNING), network.transport() as one, network.transport() as other:
        car = Publisher(Loop(), rate=20.0, transport=one, clock=hosts["vehicle"].clock)
        with car, subscribe("vehicle/lidar", transport=other, clock=hosts["receiver"].clock) as live:
            assert eventually(lambda: live.next(5) and live.summary()["clock"]["state"] != "unknown")
            for by_s in (3600, -7200):
                hosts[who].by_ns += by_s * 10**9
                frames = live.stats.counts["frames"]
                assert eventually(lambda frames=frames: live.next(5) and live.stats.counts["frames"] > frames + 5)
                assert eventually(lambda: live.next(5) and 0 < live.stats.latency_ms.recent()[-1] < 1500)
            summary = live.summary()
            assert summary["clock"]["state"] == "corrected"
            assert summary["clock"]["jumps"] >= 1
            assert max(live.stats.latency_ms.recent()) < 60_000
            assert abs(car.status()["stamp_ns"] - hosts["vehicle"].clock.wall_ns()) < 60 * 10**9
            assert car.status()["time_source"]["stamps"] == "host"
    assert summary["errors"] == {}
    assert eventually(lambda: set(threading.enumerate()) <= before)
