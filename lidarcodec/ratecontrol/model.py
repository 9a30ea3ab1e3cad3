"""What a frame will take: a codec's curve, bent to fit the frames before, and the parts that no knob turns.

ln(bits per return of the range) = ln(curve(value)) + roughness * tilt(curve(value)). Frames differ most by how rough
the scene is, and the next frame is 0.1 s from the last, so one number learned quickly does. A rough scene takes a tenth
more than a smooth one when coded without loss, and twice as much in steps of metres: that is the tilt. Intensity is
learned by the return; mask, azimuth, side information and header by the packet.

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
"""The two drives of the curves lie at -0.5 and 0.5. From 6.7 on coarse would be expected to take more than fine."""
MAX_RENEWAL: Final = 4.0
RENEWAL_SHARE: Final = 0.3
DROP: Final = 0.2
"""A picture like one that was just sent costs next to nothing, and says nothing about the next."""
MOST_SCALE: Final = 30.0
"""Slabs of few packets have many times the headers of the whole turns that curves were measured with."""


@dataclass(frozen=True)
class RangeModel:
    """roughness: 0 where a stream takes what the curve says; seen: messages learned from.

    renewal: how often a message that refers to none before takes what it otherwise would; None until one told
    """

    roughness: float = 0.0
    seen: int = 0
    renewal: float | None = None


@dataclass(frozen=True)
class Scale:
    """How often a part takes what the curve says; seen: messages learned from."""

    times: float = 1.0
    seen: int = 0


def gain(seconds: float, seen: int) -> float:
    """How much of an error a model takes in: all of the first, then by the time that the message covers."""
    return max(1.0 - math.exp(-seconds / LEARN_S), 1.0 / (seen + 1))


def tilt(guess: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """(N,) float64, how much roughness moves the logarithm of so many bits a return; from pcodec's two drives."""
    return np.maximum(0.4 - 0.15 * np.log(guess), 0.1)


def bits_per_return(model: RangeModel, curve: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """(N,) float64, bits of a return's range where the curve says (N,) bits."""
    bits: npt.NDArray[np.float64] = curve * np.exp(model.roughness * tilt(curve))
    return bits


def learned(
    model: RangeModel, seconds: float, bits: float, returns: int, guess: float, drop: float = math.inf
) -> RangeModel:
    """The model after ranges that took `bits` where the curve says `guess` a return; no return teaches nothing.

    drop: no message is believed that it took less than expected by a factor with a greater logarithm.
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
    """As `learned`, of ranges that refer to none before. renewal: how much more those take, as far as is known.

    What it took more than it should is laid partly on the scene, partly on the renewal.
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
    """The scale after a message whose part took `bits` where the curve says `guess`; of no guess nothing is learned."""
    if guess <= 0.0:
        return scale
    times = scale.times + gain(seconds, scale.seen) * (bits / guess - scale.times)
    return Scale(min(max(times, 1.0 / MOST_SCALE), MOST_SCALE), scale.seen + 1)
