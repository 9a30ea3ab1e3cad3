"""Predicts the size of a frame: a codec's curve, corrected by earlier frames, plus the parts without a knob.

ln(bits per return of the range) = ln(curve(value)) + roughness * tilt(curve(value)). Frames differ most in the
roughness of the scene, and the next frame is only 0.1 s later, so one quickly learned number is enough. A rough scene
needs a tenth more bits than a smooth one without loss, and twice as many with steps of metres: that is the tilt.
Intensity is learned per return; mask, azimuth, side information and header per packet.

>>> model = learned(RangeModel(), seconds=0.1, bits=4e5, returns=100_000, guess=2.0)
>>> bits_per_return(model, np.array([2.0])).round(3).tolist()
[4.0]
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

LEARN_S: Final = 0.08
"""Time constant of learning: a frame of 0.1 s moves a model by 71 % of its error, a slab of 8 ms by 10 %."""
MAX_ROUGHNESS: Final = 6.0
"""Limit of the roughness. The two drives of the curves are at -0.5 and 0.5. From 6.7 on the model would predict more
bits for coarse points than for fine ones."""
MAX_RENEWAL: Final = 4.0
RENEWAL_SHARE: Final = 0.3
DROP: Final = 0.2
"""An image like the previous one needs almost no bits, and says nothing about the next."""
MOST_SCALE: Final = 30.0
"""Slabs of few packets have many times more headers than the whole turns in the measurement of the curves."""


@dataclass(frozen=True)
class RangeModel:
    """roughness: 0 if a stream needs the bits of the curve; seen: number of learned messages

    renewal: size of a message without references relative to its usual size; None before the first one
    """

    roughness: float = 0.0
    seen: int = 0
    renewal: float | None = None


@dataclass(frozen=True)
class Scale:
    """Size of a part relative to the curve; seen: number of learned messages"""

    times: float = 1.0
    seen: int = 0


def gain(seconds: float, seen: int) -> float:
    """Share of an error that a model learns: all of the first, then by the time that the message covers."""
    return max(1.0 - math.exp(-seconds / LEARN_S), 1.0 / (seen + 1))


def tilt(guess: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """(N,) float64, effect of roughness on the logarithm of the bits a return; from pcodec on two drives."""
    return np.maximum(0.4 - 0.15 * np.log(guess), 0.1)


def bits_per_return(model: RangeModel, curve: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """(N,) float64, predicted bits of a return's range, from the (N,) bits of the curve."""
    bits: npt.NDArray[np.float64] = curve * np.exp(model.roughness * tilt(curve))
    return bits


def learned(
    model: RangeModel, seconds: float, bits: float, returns: int, guess: float, drop: float = math.inf
) -> RangeModel:
    """The model after ranges of `bits`, where the curve gives `guess` bits a return. Without returns it is unchanged.

    drop: limit for the logarithm of the factor by which a message may be smaller than predicted
    """
    if not returns:
        return model
    tilted = float(tilt(np.array([guess]))[0])
    seen = math.log(max(bits, 1.0) / (returns * guess)) / tilted
    if model.seen:
        seen = max(seen, model.roughness - drop / tilted)
    roughness = model.roughness + gain(seconds, model.seen) * (seen - model.roughness)
    return RangeModel(min(max(roughness, -MAX_ROUGHNESS), MAX_ROUGHNESS), model.seen + 1, model.renewal)


def renewed(model: RangeModel, seconds: float, bits: float, returns: int, guess: float, renewal: float) -> RangeModel:
    """As `learned`, for ranges without references. renewal: their known relative size

    The error changes partly the roughness and partly the renewal.
    """
    if not returns:
        return model
    after = learned(model, seconds, bits / renewal, returns, guess, DROP)
    if not model.seen:
        return after
    expected = returns * float(bits_per_return(model, np.array([guess]))[0])
    times = renewal * (max(bits, 1.0) / (renewal * expected)) ** RENEWAL_SHARE
    roughness = model.roughness + (1.0 - RENEWAL_SHARE) * (after.roughness - model.roughness)
    return RangeModel(roughness, after.seen, min(max(times, 1.0), MAX_RENEWAL))


def scaled(scale: Scale, seconds: float, bits: float, guess: float) -> Scale:
    """The scale after a message with `bits` for a part, where the curve gives `guess`. Without a guess it is
    unchanged.
    """
    if guess <= 0.0:
        return scale
    times = scale.times + gain(seconds, scale.seen) * (bits / guess - scale.times)
    return Scale(min(max(times, 1.0 / MOST_SCALE), MOST_SCALE), scale.seen + 1)
