"""The controller: (state, frame) to a working point, (state, what was sent) to the next state. No clock.

>>> from lidarcodec.ratecontrol.curve import Pins, operating_curve
>>> plan = Plan(1e6, "riddle", operating_curve("riddle", Pins()))
>>> load = Load(returns=100_000, packets=348, seconds=0.1)
>>> state = RateState()
>>> point = plan.curve.points[chosen(state, plan, load)]
>>> point.step > 1, point.value <= 0.3
(True, True)
>>> state = measured(state, plan, 0, load, Sizes(range=50e3, intensity=0, rest=10e3))
>>> low, high = reachable_kbps(state, plan)
>>> 550 < low < 650
True
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec.ratecontrol.budget import WINDOW_S, Budget, covered_s, kbps, share, spend
from lidarcodec.ratecontrol.curve import Curve
from lidarcodec.ratecontrol.model import DROP, RangeModel, Scale, bits_per_return, gain, learned, renewed, scaled

Floats = npt.NDArray[np.float64]

TOLERANCE = 0.05
"""A mean of five seconds within this fraction of the target has reached it."""
HORIZON_S = 1.0
"""In what time a knob that is dear to turn pays back."""
HOLD = 0.12
"""Such a knob stays while the logarithm of what a frame will take is no further than this from what it should; a dearer
one longer."""
SPILL = 1.6
"""A message of a dear knob that takes so many times its share is not sent: another scene began. It is coded anew."""
SAME_STEP = 0.1
"""The step of the lattice stays while one of its points is so near, as a logarithm, to what a frame may take."""
LONGEST_S = 0.5
"""Time between two frames that are sent, at the lowest rates: two a second."""
SETTLED_S = 1.0
"""Before so much was sent, whether a target is reached is a prediction."""


class Load(NamedTuple):
    """What a message carries: returns of the original frames, packets, and seconds in which the sensor made them."""

    returns: int
    packets: int
    seconds: float


class Sizes(NamedTuple):
    """Bits of a message: of ranges, intensity, calibration, and all else; renewed: it refers to none before."""

    range: float
    intensity: float
    rest: float
    calibration: float = 0.0
    renewed: bool = False

    @property
    def total(self) -> float:
        """All of them."""
        return self.range + self.intensity + self.rest + self.calibration


@dataclass(frozen=True, eq=False)
class Plan:
    """What the settings ask for, worked out once.

    target_bps: the target; model: name of the range model that applies; curve: the working points to choose from
    renewal: as in the knob
    """

    target_bps: float
    model: str
    curve: Curve
    renewal: float | None = None

    @cached_property
    def steps(self) -> Floats:
        """(N,) float64, the step of the lattice at each point."""
        return np.array([float(point.step) for point in self.curve.points])

    @cached_property
    def guess(self) -> Floats:
        """(N,) float64, bits of the range of a return that is sent, at each point, in a scene like those measured."""
        guess: Floats = self.curve.range * self.steps
        return guess


@dataclass(frozen=True)
class RateState:
    """All that the controller knows.

    ranges: models by name; intensity, rest: how often these take what the curve says
    roughness: that of the range model that learned last, where a new one begins
    flow: returns and seconds of a packet, None before the first message; unit: frames in the last message
    """

    budget: Budget = field(default_factory=Budget)
    ranges: dict[str, RangeModel] = field(default_factory=dict)
    intensity: Scale = field(default_factory=Scale)
    rest: Scale = field(default_factory=Scale)
    roughness: float = 0.0
    flow: tuple[float, float] | None = None
    unit: int = 1


def _model(state: RateState, plan: Plan) -> RangeModel:
    return state.ranges.get(plan.model) or RangeModel(state.roughness)


def expected_range(state: RateState, plan: Plan, load: Load) -> Floats:
    """(N,) float64, bits of the ranges of a message with that load at each point of the plan."""
    bits: Floats = load.returns / plan.steps * bits_per_return(_model(state, plan), plan.guess)
    return bits


def expected_bits(state: RateState, plan: Plan, load: Load) -> Floats:
    """(N,) float64, bits of a message with that load at each point of the plan."""
    beside = state.intensity.times * plan.curve.intensity + state.rest.times * plan.curve.rest
    bits: Floats = load.returns * beside + expected_range(state, plan, load)
    return bits


def chosen(state: RateState, plan: Plan, load: Load, last: int | None = None, *, key: bool = False) -> int:
    """Index of the point for a frame of that load. last: that of the frame before; key: it refers to none anyway."""
    unit_s = load.seconds * state.unit
    expected = expected_bits(state, plan, load)
    if plan.renewal is None:
        return _nearest(expected, share(state.budget, load.seconds, unit_s, plan.target_bps), plan, last)
    wanted = share(state.budget, load.seconds, unit_s, plan.target_bps, HORIZON_S)
    if last is None:
        return _nearest(expected, wanted)
    renewal = _renewal(state, plan)
    off = abs(math.log(max(expected[last], 1.0) / max(wanted, 1.0)))
    if not key and (off <= HOLD * math.sqrt(renewal) or _nearest(expected, wanted) == last):
        return last
    # The renewal is paid for by the frames of the horizon.
    more = (renewal - 1.0) * min(load.seconds / HORIZON_S, 1.0)
    return _nearest(expected + more * expected_range(state, plan, load), wanted)


def _nearest(expected: Floats, wanted: float, plan: Plan | None = None, last: int | None = None) -> int:
    """Index of the point whose bits are nearest; of those of the last frame's step if one is near enough, so that a
    stream does not go to and fro between two steps."""
    off = np.abs(np.log(np.maximum(expected, 1.0) / max(wanted, 1.0)))
    best = int(np.argmin(off))
    if plan is None or last is None or last >= len(off) or plan.steps[last] == plan.steps[best]:
        return best
    same = np.where(plan.steps == plan.steps[last], off, np.inf)
    kept = int(np.argmin(same))
    return kept if same[kept] <= SAME_STEP else best


def _renewal(state: RateState, plan: Plan) -> float:
    model = state.ranges.get(plan.model)
    known = None if model is None else model.renewal
    return known or plan.renewal or 1.0


def skips(state: RateState, plan: Plan, load: Load, since_s: float) -> bool:
    """Whether a frame is left out, because not even the cheapest working point keeps the target with all frames.

    since_s: time since the last frame that was sent; after LONGEST_S one is sent whatever it takes
    """
    least = float(expected_bits(state, plan, load)[0])
    if least <= plan.target_bps * load.seconds or since_s + load.seconds > LONGEST_S:
        return False
    return state.budget.debt_s > load.seconds / 2


def left_out(state: RateState, plan: Plan, load: Load) -> RateState:
    """The state after a frame that was left out."""
    return replace(state, budget=spend(state.budget, load.seconds, 0.0, plan.target_bps))


def measured(state: RateState, plan: Plan, level: int, load: Load, sizes: Sizes, frames: int = 1) -> RateState:
    """The state after a message of `frames` frames, made at a point, took these bits."""
    expected = expected_bits(state, plan, load)
    asked = plan.target_bps * load.seconds
    idle = level == len(plan.curve.points) - 1 and float(expected[-1]) <= asked
    ranges = _model(state, plan)
    sent = max(round(load.returns / plan.steps[level]), 1) if load.returns else 0
    of_ranges = (load.seconds, sizes.range, sent, float(plan.guess[level]))
    if plan.renewal is not None and sizes.renewed:
        ranges = renewed(ranges, *of_ranges, _renewal(state, plan))
    else:
        ranges = learned(ranges, *of_ranges, math.inf if plan.renewal is None else DROP)
    weight = gain(load.seconds, _model(state, plan).seen)
    flow = (load.returns / load.packets, load.seconds / load.packets)
    before = state.flow or flow
    return RateState(
        budget=spend(state.budget, load.seconds, sizes.total, plan.target_bps, idle=idle),
        ranges={**state.ranges, plan.model: ranges},
        intensity=scaled(
            state.intensity, load.seconds, sizes.intensity, load.returns * float(plan.curve.intensity[level])
        ),
        rest=scaled(state.rest, load.seconds, sizes.rest, load.returns * float(plan.curve.rest[level])),
        roughness=ranges.roughness,
        flow=(before[0] + weight * (flow[0] - before[0]), before[1] + weight * (flow[1] - before[1])),
        unit=frames,
    )


def surprised(state: RateState, plan: Plan, level: int, load: Load, sizes: Sizes) -> RateState | None:
    """The state that knows the scene of a message that takes far too much, and is coded anew; None for any other."""
    wanted = plan.target_bps * load.seconds
    if plan.renewal is None or sizes.renewed or level == 0 or not load.returns or sizes.total <= SPILL * wanted:
        return None
    bits = sizes.range / _renewal(state, plan)  # nothing before it was of use to such a message
    sent = max(round(load.returns / plan.steps[level]), 1)
    ranges = learned(_model(state, plan), HORIZON_S, bits, sent, float(plan.guess[level]))
    return replace(state, ranges={**state.ranges, plan.model: ranges}, roughness=ranges.roughness)


def retargeted(state: RateState) -> RateState:
    """The state under another target: what was learned stays, debts and means begin anew."""
    return replace(state, budget=Budget())


def reachable_kbps(state: RateState, plan: Plan) -> tuple[float, float] | None:
    """The lowest and the highest kbit/s that the knob can give on the last frames' scene; None before the first."""
    if state.flow is None:
        return None
    returns, seconds = state.flow
    of_flow = expected_bits(state, plan, Load(1, 1, seconds))[[0, -1]]
    low, high = (returns * of_flow / seconds / 1e3).tolist()
    return low, high


def limited_by(state: RateState, plan: Plan) -> str:
    """What sets the size: the `target`, or the `codec` at its finest, or at its coarsest, the `floor`."""
    ends = reachable_kbps(state, plan)
    target_kbps = plan.target_bps / 1e3
    if ends is not None and target_kbps < ends[0]:
        return "floor"
    if ends is not None and target_kbps > ends[1]:
        return "codec"
    return "target"


def on_target(state: RateState, plan: Plan) -> bool:
    """Whether the mean of the last five seconds is the target; at the start, whether it will be."""
    target_kbps = plan.target_bps / 1e3
    if covered_s(state.budget) < SETTLED_S:
        ends = reachable_kbps(state, plan)
        return ends is None or ends[0] <= target_kbps <= ends[1]
    mean = kbps(state.budget, WINDOW_S)
    return mean is None or abs(mean / target_kbps - 1.0) <= TOLERANCE
