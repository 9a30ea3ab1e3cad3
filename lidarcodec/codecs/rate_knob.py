"""RateKnob: the one setting of a codec that a target bitrate turns.

A codec's file says which it is: `bound_knob` for `max_error_m`, `quality_knob` for a quality from 1 to 100, `crf_knob`
for the quality of a video, which begins anew each time it is turned.

>>> quality_knob().with_value(StreamSettings(codec="jpeg", target_kbps=2000), 50).codec_settings
{'quality': 50}
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from lidarcodec.settings import MAX_BOUND_M, StreamSettings, step_of
from lidarcodec.units import RANGE_STEP_M

BOUND = "max_error_m"
CRF = "crf"
FINEST_CRF, COARSEST_CRF = 0.0, 51.0
CRF_STEP = 0.5


@dataclass(frozen=True)
class RateKnob:
    """setting: `max_error_m`, or a name in the codec's own settings
    values: from the coarsest, which takes fewest bits, to the finest
    renewal: how often a message that refers to none before takes what it otherwise would, before it is measured; such a
        message is the price of turning the knob. None: messages refer to none anyway
    beside: names and values of other settings of the codec with which it shows more at a bitrate than with its
        defaults; not with the purpose `localise`, whose working points were measured without
    """

    setting: str
    values: tuple[float, ...]
    renewal: float | None = None
    beside: tuple[tuple[str, str], ...] = ()

    def with_value(self, settings: StreamSettings, value: float) -> StreamSettings:
        """The settings with the knob at a value, and with what goes beside it where the settings leave it open."""
        if self.setting == BOUND:
            return settings.model_copy(update={BOUND: value})
        beside = {} if settings.purpose == "localise" else dict(self.beside)
        own = {**beside, **settings.codec_settings, self.setting: value}
        return settings.model_copy(update={"codec_settings": own})

    def places(self, values: Sequence[float]) -> list[float]:
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


def bound_knob() -> RateKnob:
    """The knob of a codec that keeps a bound: from 20 m to lossless."""
    return RateKnob(BOUND, _bounds())


def quality_knob(**beside: str) -> RateKnob:
    """The knob of a codec with a `quality` from 1 to 100 of its own: in quarters below 5, where a step of 1 is much."""
    values = (*(quarters / 4 for quarters in range(4, 20)), *range(5, 101))
    return RateKnob("quality", values, beside=tuple(beside.items()))


def crf_knob(renewal: float, **beside: str) -> RateKnob:
    """The knob of a video: x264's `crf`, from 51 to 0."""
    count = round((COARSEST_CRF - FINEST_CRF) / CRF_STEP)
    values = tuple(COARSEST_CRF - CRF_STEP * step for step in range(count + 1))
    return RateKnob(CRF, values, renewal, tuple(beside.items()))
