"""Fitting: a group takes what it may, whatever its codec makes of the knob, in few attempts."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarcodec.ratecontrol.budget import MAX_DEBT_S, Budget
from lidarcodec.ratecontrol.controller import Load, Plan, RateState
from lidarcodec.ratecontrol.curve import Pins, operating_curve
from lidarcodec.ratecontrol.fitting import ATTEMPTS, fitted

GROUP = Load(800_000, 2784, 0.8)


def plan_of(target: float) -> Plan:
    return Plan(1e3 * target, "jpeg-layered", operating_curve("jpeg-layered", Pins(step=1, levels=0)))


class Codec:
    """Takes what the curve says, bent: more by a factor, and steeper or flatter."""

    def __init__(self, plan: Plan, factor: float = 1.0, power: float = 1.0, load: Load = GROUP) -> None:
        self.sizes = (load.returns * factor * plan.curve.range**power / 8).astype(int)
        self.calls: list[int] = []

    def __call__(self, level: int) -> bytes:
        self.calls.append(level)
        return bytes(int(self.sizes[level]))


@settings(deadline=None)
@given(st.floats(900, 4000), st.floats(0.5, 2.0), st.floats(0.8, 1.25))
def test_it_ends_near_the_target_after_few_attempts(target: float, factor: float, power: float) -> None:
    plan = plan_of(target)
    codec = Codec(plan, factor, power)
    level, data = fitted(RateState(), plan, GROUP, 80e3, codec)
    wanted = target * 800
    nearest = np.abs(80e3 + 8 * codec.sizes - wanted).min()
    assert abs(80e3 + 8 * len(data) - wanted) <= max(0.05 * wanted, nearest) + 8
    assert len(data) == codec.sizes[level]
    assert len(codec.calls) == len(set(codec.calls)) <= ATTEMPTS


@pytest.mark.parametrize(("target", "end"), [(1, 0), (1e6, -1)])
def test_a_target_out_of_reach_takes_the_end_of_the_knob(target: float, end: int) -> None:
    plan = plan_of(target)
    codec = Codec(plan, 1.3)
    level, _ = fitted(RateState(), plan, GROUP, 2e6 if end == 0 else 0.0, codec)
    assert codec.sizes[level] == codec.sizes[end]


def test_a_debt_is_paid_by_the_next_group() -> None:
    plan = plan_of(2000)
    _, data = fitted(RateState(Budget(debt_s=0.1)), plan, GROUP, 0.0, Codec(plan))
    assert 8 * len(data) == pytest.approx(2e6 * (0.8 - 0.1), rel=0.04)
    _, data = fitted(RateState(Budget(debt_s=MAX_DEBT_S)), plan, GROUP, 0.0, Codec(plan))
    assert 8 * len(data) > 2e6 * 0.4, "no group is spoilt by the one before it"


def test_a_group_without_returns_is_coded_once() -> None:
    plan = plan_of(2000)
    empty = Load(0, 2784, 0.8)
    codec = Codec(plan, load=empty)
    assert fitted(RateState(), plan, empty, 1e3, codec)[1] == b""
    assert len(codec.calls) == 1
