"""RateKnob: the one setting of a codec that a target bitrate turns, and what to expect of it before it is measured.

A codec's file says which it is: `bound_knob` for `max_error_m`, `quality_knob` for a quality from 1 to 100, `crf_knob`
for the quality of a video, which begins anew each time it is turned.

>>> knob = quality_knob(((1, 0.5), (50, 2.0), (100, 8.0)))
>>> knob.with_value(StreamSettings(codec="jpeg", target_kbps=2000), 50).codec_settings
{'quality': 50}
>>> knob.guess((75,)).round(6).tolist()
[4.0]
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt

from lidarcodec.settings import MAX_BOUND_M, StreamSettings, step_of
from lidarcodec.units import RANGE_STEP_M

BOUND = "max_error_m"
CRF = "crf"
FINEST_CRF, COARSEST_CRF = 0.0, 51.0
CRF_STEP = 0.5
Curve = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class RateKnob:
    """setting: `max_error_m`, or a name in the codec's own settings
    values: from the coarsest, which takes fewest bits, to the finest
    curve: (value, bits of a return's range), coarsest first: the mean of two drives; ratecontrol bends it to a stream
    renewal: how often a message that refers to none before takes what it otherwise would, before it is measured; such a
        message is the price of turning the knob. None: messages refer to none anyway
    """

    setting: str
    values: tuple[float, ...]
    curve: Curve
    renewal: float | None = None

    def allowed(self, settings: StreamSettings) -> tuple[float, ...]:
        """The values that keep the settings' bound, coarsest first."""
        if self.setting != BOUND or settings.max_error_m is None:
            return self.values
        bound = settings.max_error_m
        within = tuple(value for value in self.values if step_of(value) <= step_of(bound))
        coarsest = (step_of(bound) - 1) // 2 * RANGE_STEP_M
        return within if within[0] == coarsest else (coarsest, *within)

    def with_value(self, settings: StreamSettings, value: float) -> StreamSettings:
        """The settings with the knob at a value."""
        if self.setting == BOUND:
            return settings.model_copy(update={BOUND: value})
        return settings.model_copy(update={"codec_settings": {**settings.codec_settings, self.setting: value}})

    def guess(self, values: Sequence[float]) -> npt.NDArray[np.float64]:
        """(N,) float64, bits of a return's range at each of N values: log-linear between the points of the curve."""
        at, bits = zip(*self.curve, strict=True)
        return np.exp(np.interp(self._places(values), self._places(at), np.log(bits)))

    def _places(self, values: Sequence[float]) -> list[float]:
        """Values on the scale on which the logarithm of the bits is nearly straight; ascending from the coarsest."""
        if self.setting == BOUND:
            return [-float(np.log(step_of(value))) for value in values]
        return [-float(value) if self.setting == CRF else float(value) for value in values]


@cache
def _bounds() -> tuple[float, ...]:
    """Bounds of every step up to 41, then of steps 5 % apart, up to 20 m; coarsest first."""
    half, halves = 0, [0]
    while half < step_of(MAX_BOUND_M) // 2:
        half = min(max(half + 1, round(half * 1.05)), step_of(MAX_BOUND_M) // 2)
        halves.append(half)
    return tuple(round(half * RANGE_STEP_M, 3) for half in reversed(halves))


def bound_knob(curve: Curve) -> RateKnob:
    """The knob of a codec that keeps a bound: from 20 m to lossless."""
    return RateKnob(BOUND, _bounds(), curve)


def quality_knob(curve: Curve) -> RateKnob:
    """The knob of a codec with a `quality` from 1 to 100 of its own: in quarters below 5, where a step of 1 is much."""
    return RateKnob("quality", (*(quarters / 4 for quarters in range(4, 20)), *range(5, 101)), curve)


def crf_knob(curve: Curve, renewal: float) -> RateKnob:
    """The knob of a video: x264's `crf`, from 51 to 0."""
    count = round((COARSEST_CRF - FINEST_CRF) / CRF_STEP)
    return RateKnob(CRF, tuple(COARSEST_CRF - CRF_STEP * step for step in range(count + 1)), curve, renewal)
