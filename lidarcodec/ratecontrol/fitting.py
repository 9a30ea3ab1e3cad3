"""Fitting: codes a message of several frames with more than one value of the knob, until it has its allowed size.

If a message of one frame is too large, the next one compensates 0.1 s later. A group of eight frames is 0.8 s of the
stream. Nothing can compensate for it within a second, so its size must be right at once.

>>> from lidarcodec.ratecontrol.curve import Pins, operating_curve
>>> plan = Plan(2.5e6, "jpeg-layered", operating_curve("jpeg-layered", Pins(step=1, levels=0)))
>>> load = Load(returns=800_000, packets=2784, seconds=0.8)
>>> def a_half_more(level: int) -> bytes:
...     return bytes(int(load.returns * plan.curve.range[level] * 1.5 / 8))
>>> level, data = fitted(RateState(), plan, load, 0.0, a_half_more)
>>> abs(len(data) * 8 / load.seconds / 2.5e6 - 1) < 0.05
True
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.ratecontrol.budget import share
from lidarcodec.ratecontrol.controller import Load, Plan, RateState, expected_range

ATTEMPTS: Final = 4
"""Most attempts. Each takes as long as encoding the group without a target. Two are nearly always enough."""
CLOSE: Final = 0.03
"""A message is sent if it misses the budget by less than this fraction of its size."""

STEEPEST: Final = 0.5
"""Limit of extrapolation beyond the attempts, because noise between two adjacent levels may look steep."""


def fitted(
    state: RateState, plan: Plan, load: Load, beside: float, attempt: Callable[[int], bytes]
) -> tuple[int, bytes]:
    """Index of the point at which a message fits the budget, and the ranges coded at this point.

    load: load of the whole message; beside: its bits without the ranges; attempt: codes the ranges at a point
    """
    wanted = share(state.budget, load.seconds, load.seconds, plan.target_bps)
    guess = expected_range(state, plan, load)
    expected, tried = guess, dict[int, bytes]()

    def miss(level: int) -> float:
        return abs(beside + 8 * len(tried[level]) - wanted)

    while len(tried) < ATTEMPTS:
        level = int(np.argmin(np.abs(beside + expected - wanted)))
        if level in tried:
            break
        tried[level] = attempt(level)
        if miss(level) <= CLOSE * wanted or not load.returns:
            break
        expected = _corrected(guess, tried)
    best = min(tried, key=miss)
    return best, tried[best]


def _corrected(guess: npt.NDArray[np.float64], tried: dict[int, bytes]) -> npt.NDArray[np.float64]:
    """(N,) float64, the guess corrected to agree with the attempts, log-linear between and beyond them."""
    levels = sorted(tried)
    at = np.log(guess)
    off = np.log([max(8 * len(tried[level]), 1) for level in levels]) - at[levels]
    bend = np.interp(np.arange(len(guess)), levels, off)
    for inner, outer, beyond in ((1, 0, slice(levels[0])), (-2, -1, slice(levels[-1], None))):
        if len(levels) > 1 and at[levels[outer]] != at[levels[inner]]:
            slope = (off[outer] - off[inner]) / (at[levels[outer]] - at[levels[inner]])
            bend[beyond] = off[outer] + np.clip(slope, -STEEPEST, STEEPEST) * (at[beyond] - at[levels[outer]])
    bent: npt.NDArray[np.float64] = guess * np.exp(bend)
    return bent
