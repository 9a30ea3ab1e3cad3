"""The controller alone, on recorded sizes and on any sizes: an uplink gets what was asked for, and no surprise."""

from __future__ import annotations

import json
import math
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarcodec.codecs import table
from lidarcodec.ratecontrol.budget import covered_s, kbps
from lidarcodec.ratecontrol.control import pins_of
from lidarcodec.ratecontrol.controller import (
    Load,
    Plan,
    RateState,
    Sizes,
    chosen,
    measured,
    on_target,
    reachable_kbps,
    retargeted,
    surprised,
)
from lidarcodec.ratecontrol.curve import Pins, operating_curve
from lidarcodec.settings import StreamSettings, step_of

PACKETS, SECONDS = 348, 0.1002
TRACES = Path(__file__).parent / "traces.json"


@cache
def traces() -> dict:
    return json.loads(TRACES.read_text())


class Recorded:
    """Sizes of a drive's frames at any value of the knob: log-linear between those that were measured."""

    def __init__(self, drive: str, codec: str) -> None:
        trace = traces()[drive][codec]
        self.knob = table.codec(codec).knob
        values = sorted((float(value) for value in trace["range"]), reverse=self.knob.setting == "max_error_m")
        self.places = self.knob.places(values)
        self.bits = np.log(np.array([trace["range"][f"{value:g}"] for value in values], float))
        self.trace = trace

    def __len__(self) -> int:
        return len(self.trace["points"])

    def load(self, frame: int) -> Load:
        return Load(self.trace["points"][frame], PACKETS, SECONDS)

    def sizes(self, frame: int, value: float, intensity: bool = False) -> Sizes:
        ranges = math.exp(np.interp(self.knob.places([value])[0], self.places, self.bits[:, frame]))
        return Sizes(ranges, self.trace["intensity"][frame] if intensity else 0.0, self.trace["rest"][frame])


def plan_of(codec: str, target_kbps: float, **others: object) -> Plan:
    """A plan in which only the knob moves."""
    settings = StreamSettings(codec=codec, target_kbps=target_kbps, reduction="all", intensity="off", **others)
    return Plan(1e3 * target_kbps, codec, operating_curve(codec, pins_of(settings)), table.codec(codec).knob.renewal)


def values(plan: Plan) -> list[float]:
    return [point.value for point in plan.curve.points]


def play(state: RateState, plan: Plan, recorded: Recorded, frames: range) -> tuple[RateState, list[float]]:
    """The state after some frames, and their bits."""
    spent = []
    for frame in frames:
        load = recorded.load(frame)
        level = chosen(state, plan, load)
        sizes = recorded.sizes(frame, values(plan)[level])
        state = measured(state, plan, level, load, sizes)
        spent.append(sum(sizes))
    return state, spent


def kbps_of(bits: list[float], frames: int) -> np.ndarray:
    """Mean of every so many frames in a row."""
    return np.convolve(bits, np.ones(frames), "valid") / (frames * SECONDS * 1e3)


@pytest.mark.parametrize("drive", ["sfnd", "0013"])
@pytest.mark.parametrize(
    ("codec", "target"),
    [
        *((c, t) for c in ("zstd", "pcodec", "jpeg") for t in (2500, 3500, 5000)),
        ("pcodec", 1500),
    ],
)
def test_a_drive_keeps_to_the_target(drive: str, codec: str, target: float) -> None:
    recorded = Recorded(drive, codec)
    _, spent = play(RateState(), plan_of(codec, target), recorded, range(len(recorded)))
    assert abs(kbps_of(spent, 50) / target - 1).max() < 0.05
    assert kbps_of(spent, 10).max() < 1.2 * target


@pytest.mark.parametrize(("first", "second"), [("sfnd", "0013"), ("0013", "sfnd")])
@pytest.mark.parametrize("codec", ["zstd", "pcodec", "jpeg"])
def test_another_scene_settles_within_a_second(first: str, second: str, codec: str) -> None:
    plan = plan_of(codec, 2500)
    state, before = play(RateState(), plan, Recorded(first, codec), range(40))
    _, after = play(state, plan, Recorded(second, codec), range(40))
    assert abs(kbps_of(before + after, 10)[-30:] / 2500 - 1).max() < 0.05
    assert kbps_of(before + after, 10)[10:].max() < 1.2 * 2500


@pytest.mark.parametrize(("one", "other"), [("pcodec", "jpeg"), ("jpeg", "zstd"), ("zstd", "pcodec")])
def test_another_codec_settles_within_a_second(one: str, other: str) -> None:
    state, before = play(RateState(), plan_of(one, 2500), Recorded("0013", one), range(25))
    _, after = play(state, plan_of(other, 2500), Recorded("0013", other), range(25, 56))
    assert abs(kbps_of(before + after, 10)[-20:] / 2500 - 1).max() < 0.05
    assert kbps_of(before + after, 10)[5:].max() < 1.2 * 2500


def test_what_was_learned_of_the_scene_serves_a_codec_that_was_never_used() -> None:
    """Without it the first frames after a switch would be a third off."""
    state, _ = play(RateState(), plan_of("pcodec", 2500), Recorded("sfnd", "pcodec"), range(20))
    _, after = play(state, plan_of("zstd", 2500), Recorded("sfnd", "zstd"), range(20, 21))
    assert after[0] == pytest.approx(2500e3 * SECONDS, rel=0.1)


def test_the_reachable_interval_is_right_far_from_where_the_knob_stands() -> None:
    """An operator chooses the next target by it."""
    for drive in ("sfnd", "0013"):
        for codec in ("zstd", "pcodec"):
            recorded = Recorded(drive, codec)
            plan = plan_of(codec, 2000)
            state, _ = play(RateState(), plan, recorded, range(len(recorded)))
            ends = reachable_kbps(state, plan)
            assert ends is not None
            last = len(recorded) - 1
            for said, value, within in zip(ends, (values(plan)[0], values(plan)[-1]), (0.4, 0.2), strict=True):
                true = sum(recorded.sizes(last, value)) / SECONDS / 1e3
                assert said == pytest.approx(true, rel=within)


def test_out_of_reach_gives_the_best_and_says_so() -> None:
    recorded = Recorded("0013", "pcodec")
    for target, best in ((100, 0), (20_000, -1)):
        plan = plan_of("pcodec", target)
        state, _ = play(RateState(), plan, recorded, range(40))
        assert values(plan)[chosen(state, plan, recorded.load(40))] == values(plan)[best]
        assert not on_target(state, plan)
        reachable = plan_of("pcodec", 2500)
        assert not on_target(state, reachable)
        _, after = play(retargeted(state), reachable, recorded, range(20, 50))
        assert kbps_of(after, 10).max() < 1.2 * 2500
        assert kbps_of(after, 10)[10:].min() > 0.95 * 2500


def test_a_target_in_reach_again_is_kept_at_once() -> None:
    """Time out of reach leaves neither a debt to starve for nor savings to flood the path with."""
    plan = plan_of("pcodec", 2500, max_error_m=0.01)
    state, _ = play(RateState(), plan, Recorded("0013", "pcodec"), range(50))
    assert not on_target(state, plan)
    free = plan_of("pcodec", 2500)
    _, after = play(state, free, Recorded("0013", "pcodec"), range(50))
    assert abs(kbps_of(after, 10)[10:] / 2500 - 1).max() < 0.05


@pytest.mark.parametrize("codec", ["zstd", "pcodec"])
@pytest.mark.parametrize("bound", [0.0, 0.001, 0.01, 0.0333, 0.3])
def test_a_pinned_bound_is_used_in_full(codec: str, bound: float) -> None:
    """A finer one takes the bits of columns: at 1,000 kbit/s 4 mm in place of 1 cm, and every 12th column."""
    curve = operating_curve(codec, Pins(bound_m=bound))
    assert {step_of(point.value) for point in curve.points} == {step_of(bound)}
    steps = [point.step for point in curve.points]
    assert set(steps) > {1, 7, 24}, "columns are what gives, also between those that were measured"


def video_plan(target_kbps: float) -> Plan:
    return plan_of("h264", target_kbps)


def test_a_dear_knob_rests_while_what_it_gives_is_near_enough() -> None:
    """Each turn costs a picture that refers to none before: a tenth of the bits if it were turned with every frame."""
    plan, state, last, levels = video_plan(2000), RateState(), None, []
    rng = np.random.default_rng(4)
    load = Load(120_000, PACKETS, SECONDS)
    for _ in range(100):
        level = chosen(state, plan, load, last)
        renewed = level != last
        bits = float(plan.curve.range[level]) * load.returns * (1.3 if renewed else 1.0) * math.exp(0.05 * rng.normal())
        state = measured(state, plan, level, load, Sizes(bits, 0.0, 18e3, renewed=renewed))
        levels.append(level)
        last = level
    assert np.count_nonzero(np.diff(levels)) < 12
    assert kbps(state.budget, 5.0) == pytest.approx(2000, rel=0.03)


def test_a_picture_that_repeats_one_does_not_open_the_floodgates() -> None:
    """It costs a tenth; the next one, in the finest quality, would take half a second of the path."""
    plan, state = video_plan(800), RateState()
    load = Load(120_000, PACKETS, SECONDS)
    level = chosen(state, plan, load)
    for share in (1.15, 1.0, 1.0, 1.0, 0.1):
        bits = share * float(plan.curve.range[level]) * load.returns
        state = measured(state, plan, level, load, Sizes(bits, 0.0, 18e3, renewed=share > 1))
    after = chosen(state, plan, load, level)
    assert plan.curve.range[after] < 1.5 * plan.curve.range[level]


def test_only_a_picture_that_takes_far_too_much_is_coded_anew() -> None:
    plan, state = video_plan(800), RateState()
    load, level = Load(120_000, PACKETS, SECONDS), 20
    for share, renewed, anew in ((1.5, False, False), (1.7, True, False), (1.7, False, True)):
        known = surprised(state, plan, level, load, Sizes(share * 800e3 * SECONDS, 0.0, 0.0, renewed=renewed))
        assert (known is not None) == anew
    assert surprised(state, plan, 0, load, Sizes(1e9, 0.0, 0.0)) is None, "nothing is coarser"
    assert surprised(state, plan_of("jpeg", 800), level, load, Sizes(1e9, 0.0, 0.0)) is None


SIZE = st.floats(0, 1e12)
EVENT = st.tuples(
    st.builds(Sizes, SIZE, SIZE, SIZE, SIZE, st.booleans()),
    st.integers(0, 10**7),
    st.integers(1, 2048),
    st.sampled_from([7.2e-5, 2.88e-4, 1.152e-3]),
    st.integers(1, 64),
    st.sampled_from(["zstd", "pcodec", "jpeg", "h264"]),
)


@settings(deadline=None)
@given(st.lists(EVENT, max_size=40), st.floats(1, 1e6))
def test_whatever_frames_take_the_controller_stays_sane(events: list, target: float) -> None:
    """Never NaN, never beyond the levels, and the same again for the same sizes."""
    ends = []
    for _ in range(2):
        state, log, last = RateState(), [], {}
        for sizes, returns, packets, packet_s, frames, codec in events:
            plan = plan_of(codec, target)
            load = Load(returns, packets, packets * packet_s)
            level = last[codec] = chosen(state, plan, load, last.get(codec))
            assert 0 <= level < len(plan.curve.points)
            state = measured(state, plan, level, load, sizes, frames)
            low, high = reachable_kbps(state, plan)
            assert 0 <= low <= high < math.inf
            assert 0 <= kbps(state.budget, 5.0) < math.inf
            assert abs(state.budget.debt_s) <= 0.3
            assert len(state.budget.window) < 120
            log.append((level, low, high, on_target(state, plan)))
        ends.append((log, state))
    assert ends[0] == ends[1]


@pytest.mark.sweep
def test_slabs_of_a_packet_are_remembered_in_few_bins() -> None:
    plan, state = plan_of("pcodec", 2000), RateState()
    for _ in range(20_000):
        load = Load(330, 1, 288e-6)
        state = measured(state, plan, chosen(state, plan, load), load, Sizes(500.0, 0.0, 60.0))
    assert len(state.budget.window) <= 55
    assert 5.0 <= covered_s(state.budget) <= 5.2
