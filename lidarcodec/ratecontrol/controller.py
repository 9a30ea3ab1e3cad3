"""The controller: (state, frame) to a value of the knob, (state, what was sent) to the next state. No clock.

>>> from lidarcodec.codecs.rate_knob import quality_knob
>>> knob = quality_knob(((1, 0.5), (50, 2.0), (100, 8.0)))
>>> plan = Plan.of(StreamSettings(codec="jpeg", target_kbps=3000), knob, "jpeg")
>>> load = Load(returns=100_000, packets=348, seconds=0.1)
>>> state = RateState(); plan.levels[chosen(state, plan, load)]
1.0
>>> state = measured(state, plan, plan.levels.index(1), load, Sizes(range=50e3, intensity=430e3, rest=20e3))
>>> [round(bound) for bound in reachable_kbps(state, plan)], on_target(state, plan)
([5000, 12500], False)
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec.codecs.rate_knob import RateKnob
from lidarcodec.ratecontrol.budget import WINDOW_S, Budget, covered_s, kbps, share, spend
from lidarcodec.ratecontrol.model import (
    DROP,
    FixedModel,
    RangeModel,
    bits_per_return,
    first_fixed,
    gain,
    learned,
    learned_fixed,
    renewed,
)
from lidarcodec.settings import StreamSettings

TOLERANCE = 0.05
"""A mean of five seconds within this fraction of the target has reached it."""
HORIZON_S = 1.0
"""In what time a knob that is dear to turn pays back."""
HOLD = 0.12
"""Such a knob stays while the logarithm of what a frame will take is no further than this from what it should; a dearer
one longer."""
SPILL = 1.6
"""A message of a dear knob that takes so many times its share is not sent: another scene began. It is coded anew."""
SETTLED_S = 1.0
"""Before so much was sent, whether a target is reached is a prediction."""


class Load(NamedTuple):
    """What a message carries: returns, packets, and the seconds in which the sensor made them."""

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

    target_bps: the target; model: name of the range model that applies; levels: allowed values of the knob, coarsest
    first; curve: (N,) float64, bits of a return's range at each; intensity_levels: as in the settings
    renewal: as in the knob
    """

    target_bps: float
    model: str
    levels: tuple[float, ...]
    curve: npt.NDArray[np.float64]
    intensity_levels: int
    renewal: float | None = None

    @classmethod
    def of(cls, settings: StreamSettings, knob: RateKnob, model: str) -> Plan:
        """The plan of settings with a number as target. model: name of codec and settings beside the knob."""
        levels = knob.allowed(settings)
        target_bps = 1e3 * float(settings.target_kbps) if isinstance(settings.target_kbps, int | float) else 0.0
        return cls(target_bps, model, levels, knob.guess(levels), settings.intensity_levels, knob.renewal)


@dataclass(frozen=True)
class RateState:
    """All that the controller knows.

    ranges: models by name; fixed: models by intensity levels, last_fixed: the one that learned last
    roughness: that of the range model that learned last, where a new one begins
    flow: returns and seconds of a packet, None before the first message; unit: frames in the last message
    """

    budget: Budget = field(default_factory=Budget)
    ranges: dict[str, RangeModel] = field(default_factory=dict)
    fixed: dict[int, FixedModel] = field(default_factory=dict)
    last_fixed: FixedModel | None = None
    roughness: float = 0.0
    flow: tuple[float, float] | None = None
    unit: int = 1


def _models(state: RateState, plan: Plan) -> tuple[RangeModel, FixedModel]:
    fixed = state.fixed.get(plan.intensity_levels) or first_fixed(plan.intensity_levels, state.last_fixed)
    return state.ranges.get(plan.model) or RangeModel(state.roughness), fixed


def expected_range(state: RateState, plan: Plan, load: Load) -> npt.NDArray[np.float64]:
    """(N,) float64, bits of the ranges of a message with that load at each level of the plan."""
    return load.returns * bits_per_return(_models(state, plan)[0], plan.curve)


def expected_bits(state: RateState, plan: Plan, load: Load) -> npt.NDArray[np.float64]:
    """(N,) float64, bits of a message with that load at each level of the plan."""
    fixed = _models(state, plan)[1]
    return load.returns * fixed.per_return + load.packets * fixed.per_packet + expected_range(state, plan, load)


def chosen(state: RateState, plan: Plan, load: Load, last: int | None = None, *, key: bool = False) -> int:
    """Index of the level for a frame of that load. last: that of the frame before; key: it refers to none anyway."""
    unit_s = load.seconds * state.unit
    expected = expected_bits(state, plan, load)
    if plan.renewal is None:
        return _nearest(expected, share(state.budget, load.seconds, unit_s, plan.target_bps))
    wanted = share(state.budget, load.seconds, unit_s, plan.target_bps, HORIZON_S)
    if last is None:
        return _nearest(expected, wanted)
    renewal = _renewal(state, plan)
    off = abs(math.log(max(expected[last], 1.0) / max(wanted, 1.0)))
    if not key and (off <= HOLD * math.sqrt(renewal) or _nearest(expected, wanted) == last):
        return last
    # The renewal is paid for by the frames of the horizon.
    ranges = load.returns * bits_per_return(_models(state, plan)[0], plan.curve)
    more = (renewal - 1.0) * min(load.seconds / HORIZON_S, 1.0)
    return _nearest(expected + more * ranges, wanted)


def _nearest(expected: npt.NDArray[np.float64], wanted: float) -> int:
    return int(np.argmin(np.abs(expected - wanted)))


def _renewal(state: RateState, plan: Plan) -> float:
    model = state.ranges.get(plan.model)
    known = None if model is None else model.renewal
    return known or plan.renewal or 1.0


def measured(state: RateState, plan: Plan, level: int, load: Load, sizes: Sizes, frames: int = 1) -> RateState:
    """The state after a message of `frames` frames, made at a level, took these bits."""
    expected = expected_bits(state, plan, load)
    asked = plan.target_bps * load.seconds
    idle = (level == 0 and expected[0] >= asked) or (level == len(plan.levels) - 1 and expected[-1] <= asked)
    ranges, fixed = _models(state, plan)
    of_ranges = (load.seconds, sizes.range, load.returns, float(plan.curve[level]))
    if plan.renewal is not None and sizes.renewed:
        ranges = renewed(ranges, *of_ranges, _renewal(state, plan))
    else:
        ranges = learned(ranges, *of_ranges, math.inf if plan.renewal is None else DROP)
    fixed = learned_fixed(fixed, load.seconds, sizes.intensity, sizes.rest, load.returns, load.packets)
    weight = gain(load.seconds, fixed.seen - 1)
    flow = (load.returns / load.packets, load.seconds / load.packets)
    before = state.flow or flow
    return RateState(
        budget=spend(state.budget, load.seconds, sizes.total, plan.target_bps, idle=idle),
        ranges={**state.ranges, plan.model: ranges},
        fixed={**state.fixed, plan.intensity_levels: fixed},
        last_fixed=fixed,
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
    ranges = learned(_models(state, plan)[0], HORIZON_S, bits, load.returns, float(plan.curve[level]))
    return replace(state, ranges={**state.ranges, plan.model: ranges}, roughness=ranges.roughness)


def retargeted(state: RateState) -> RateState:
    """The state under another target: what was learned stays, debts and means begin anew."""
    return replace(state, budget=Budget())


def reachable_kbps(state: RateState, plan: Plan) -> tuple[float, float] | None:
    """The lowest and the highest kbit/s that the knob can give on the last frames' scene; None before the first."""
    if state.flow is None:
        return None
    ranges, fixed = _models(state, plan)
    returns, seconds = state.flow
    ends = fixed.per_packet + returns * (fixed.per_return + bits_per_return(ranges, plan.curve[[0, -1]]))
    low, high = (ends / seconds / 1e3).tolist()
    return low, high


def limited_by(state: RateState, plan: Plan, level: int) -> str:
    """What sets the size at this level: the `target`, or the `codec` at its finest, or at its coarsest, the `floor`."""
    ends = reachable_kbps(state, plan)
    target_kbps = plan.target_bps / 1e3
    if ends is not None and level == 0 and target_kbps < ends[0]:
        return "floor"
    if ends is not None and level == len(plan.levels) - 1 and target_kbps > ends[1]:
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
