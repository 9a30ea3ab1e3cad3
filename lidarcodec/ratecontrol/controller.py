"""The controller: (state, frame) gives a working point, and (state, sent message) the next state. No clock.

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
"""The target counts as reached if the mean of five seconds is within this fraction of it."""
HORIZON_S = 1.0
"""Time in which a change of an expensive knob must pay off."""
HOLD = 0.12
"""An expensive knob is not changed while the logarithm of the expected size differs by less than this from that of the
wanted size; with a more expensive knob the limit is larger."""
SPILL = 1.6
"""With an expensive knob, a message of so many times its share is not sent, because the scene has changed. It is coded
again."""
SAME_STEP = 0.1
"""The step of the lattice stays while one of its points is so near, as a logarithm, to the wanted size."""
LONGEST_S = 0.5
"""Longest time between two sent frames at the lowest bitrates: two frames a second."""
SETTLED_S = 1.0
"""Before so many seconds were sent, a prediction decides whether the target is reached."""


class Load(NamedTuple):
    """Contents of a message: returns of the original frames, packets, and seconds of the sensor's time."""

    returns: int
    packets: int
    seconds: float


class Sizes(NamedTuple):
    """Bits of a message: ranges, intensity, calibration, and the rest; renewed: whether it refers to no earlier one"""

    range: float
    intensity: float
    rest: float
    calibration: float = 0.0
    renewed: bool = False

    @property
    def total(self) -> float:
        """The sum of all."""
        return self.range + self.intensity + self.rest + self.calibration


@dataclass(frozen=True, eq=False)
class Plan:
    """The settings in the form that the controller needs.

    target_bps: the target; model: name of the range model; curve: the available working points
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
        """(N,) float64, bits for the range of a sent return, at each point, in a scene like the measured ones."""
        guess: Floats = self.curve.range * self.steps
        return guess


@dataclass(frozen=True)
class RateState:
    """The state of the controller.

    ranges: range models by name; intensity, rest: their bits relative to the curve
    roughness: roughness in the range model that learned last; a new model begins with it
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
    """Index of the point for a frame with this load. last: point of the previous frame; key: whether it is a key
    frame
    """
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
    # The cost of the renewal is divided among the frames of the horizon.
    more = (renewal - 1.0) * min(load.seconds / HORIZON_S, 1.0)
    return _nearest(expected + more * expected_range(state, plan, load), wanted)


def _nearest(expected: Floats, wanted: float, plan: Plan | None = None, last: int | None = None) -> int:
    """Index of the point with the nearest bits. A point with the last frame's step is preferred if one is near enough,
    so that a stream does not alternate between two steps."""
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
    """Whether to skip a frame, because even the cheapest working point exceeds the target with all frames.

    since_s: time since the last sent frame; after LONGEST_S a frame is always sent
    """
    least = float(expected_bits(state, plan, load)[0])
    if least <= plan.target_bps * load.seconds or since_s + load.seconds > LONGEST_S:
        return False
    return state.budget.debt_s > load.seconds / 2


def left_out(state: RateState, plan: Plan, load: Load) -> RateState:
    """The state after a skipped frame."""
    return replace(state, budget=spend(state.budget, load.seconds, 0.0, plan.target_bps))


def measured(state: RateState, plan: Plan, level: int, load: Load, sizes: Sizes, frames: int = 1) -> RateState:
    """The state after a message of `frames` frames, coded at point `level`, with these sizes."""
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
    """The state after a message that is far too large and must be coded again: it has learned the scene. None for any
    other message."""
    wanted = plan.target_bps * load.seconds
    if plan.renewal is None or sizes.renewed or level == 0 or not load.returns or sizes.total <= SPILL * wanted:
        return None
    bits = sizes.range / _renewal(state, plan)  # such a message gained nothing from earlier ones
    sent = max(round(load.returns / plan.steps[level]), 1)
    ranges = learned(_model(state, plan), HORIZON_S, bits, sent, float(plan.guess[level]))
    return replace(state, ranges={**state.ranges, plan.model: ranges}, roughness=ranges.roughness)


def retargeted(state: RateState) -> RateState:
    """The state for another target: models are kept, debts and means start again."""
    return replace(state, budget=Budget())


def reachable_kbps(state: RateState, plan: Plan) -> tuple[float, float] | None:
    """The lowest and the highest kbit/s of the knob for the scene of the last frames; None before the first frame."""
    if state.flow is None:
        return None
    returns, seconds = state.flow
    of_flow = expected_bits(state, plan, Load(1, 1, seconds))[[0, -1]]
    low, high = (returns * of_flow / seconds / 1e3).tolist()
    return low, high


def limited_by(state: RateState, plan: Plan) -> str:
    """What determines the size: the `target`; the `codec` at its finest point; or the `floor`, its coarsest point."""
    ends = reachable_kbps(state, plan)
    target_kbps = plan.target_bps / 1e3
    if ends is not None and target_kbps < ends[0]:
        return "floor"
    if ends is not None and target_kbps > ends[1]:
        return "codec"
    return "target"


def on_target(state: RateState, plan: Plan) -> bool:
    """Whether the mean of the last five seconds is at the target; at the start, whether it is expected to be."""
    target_kbps = plan.target_bps / 1e3
    if covered_s(state.budget) < SETTLED_S:
        ends = reachable_kbps(state, plan)
        return ends is None or ends[0] <= target_kbps <= ends[1]
    mean = kbps(state.budget, WINDOW_S)
    return mean is None or abs(mean / target_kbps - 1.0) <= TOLERANCE
