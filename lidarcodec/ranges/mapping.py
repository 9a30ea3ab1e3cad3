"""Ranges to samples of 8, 10 or 12 bits and back, by tables that are the same on every machine.

`linear` gives every metre the same precision, up to the farthest return of the image. `sqrt` and `log` (of 1 + range /
10 m) give near returns more precision. All three use the whole range of samples. `paper` is |log2(d + 1) - 5| of d
centimetres, as in Tu 2016, with 4 integer bits. It folds below 31 cm, where ranges decode to larger ones, and leaves
half of the samples unused. For the least mean squared error `linear` is best: bits a point of `jpeg` on every 12th
frame of the KITTI training drives (sfnd, 0013) at an RMSE of

| mapping | 20 cm | 5 cm | 2.8 cm |
|---|---|---|---|
| linear | 0.95, 1.80 | 2.23, 3.37 | 3.00, 4.21 |
| linear up to 131 m, not to the farthest return | 0.95, 1.80 | 2.25, 3.38 | 3.08, 4.30 |
| power 0.9 | 0.95, 1.80 | 2.23, 3.36 | 3.00, 4.21 |
| power 0.6 | 1.01, 1.86 | 2.35, 3.47 | 3.13, 4.32 |
| log of 1 + range / 200 m | 0.95, 1.79 | 2.23, 3.36 | 3.00, 4.20 |
| log of 1 + range / 10 m | 1.10, 1.99 | 2.48, 3.65 | 3.26, 4.53 |

>>> mapping = mapping_of("linear", 12, 40950)
>>> mapping.sample[[0, 15, 40950]].tolist(), mapping.value[[0, 1, 4095]].tolist()
([0.0, 1.5, 4095.0], [0, 10, 40950])
"""

from __future__ import annotations

import math
from decimal import Context, Decimal, localcontext
from functools import lru_cache
from typing import Final, Literal, NamedTuple, get_args

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import SectionError
from lidarcodec.ranges.image.canvas import MAX_VALUE

MappingName = Literal["linear", "sqrt", "log", "paper"]
NAMES: Final[tuple[MappingName, ...]] = get_args(MappingName)
"""In the order of their numbers in messages."""
LOG_KNEE_UM: Final = 10_000_000
"""10 m: far beyond it `log` has the same precision for equal ratios, far below it is almost `linear`."""
_CANVAS_STEP_UM: Final = 2000
_CM_UM: Final = 10_000


class Scale(NamedTuple):
    """A scale of ranges: the largest one, in steps, and the step in micrometres."""

    most: int
    step_um: int

    @classmethod
    def of(cls, most: int, step_m: float) -> Scale:
        """The scale of a sensor with that range step."""
        return cls(most, max(round(step_m * 1e6), 1))

    def finer(self, top: int) -> float:
        """How much finer samples up to `top` are than those of the whole canvas of an HDL-64E, 133 m."""
        return MAX_VALUE * _CANVAS_STEP_UM / (top * self.step_um)


CANVAS: Final = Scale(MAX_VALUE, _CANVAS_STEP_UM)
"""That of an HDL-64E's canvas."""


class Mapping(NamedTuple):
    """A mapping and its inverse.

    sample: (top + 1,) float32, sample of each canvas value, not yet rounded
    value:  (2^bits,) int32, canvas value of each sample, 0..top
    """

    sample: npt.NDArray[np.float32]
    value: npt.NDArray[np.int32]


def check_top(top: int, most: int = MAX_VALUE) -> int:
    """The largest value that samples can express, if there can be such a value.

    Raises SectionError.
    """
    if not 1 <= top <= most:
        raise SectionError(f"samples for ranges up to {top}: 1 to {most} are possible")
    return top


def _log_values(top: int, peak: int, step_um: int) -> list[Decimal]:
    with localcontext(Context(prec=30)):
        knee = Decimal(LOG_KNEE_UM) / step_um
        ratio = (1 + Decimal(top) / knee) ** (Decimal(1) / peak)
        values, power = [], Decimal(1)
        for _ in range(peak + 1):
            values.append(knee * (power - 1))
            power *= ratio
    return values


_FOLD: Final = 5
"""Where |log2(d + 1) - 5| is 0, as a power of two of d + 1."""


def _paper(bits: int, top: int, step_um: int) -> Mapping:
    """The mapping of Tu 2016: 2^(bits - 4) samples to an octave."""
    octave, steps_per_cm = 1 << (bits - 4), _CM_UM / step_um
    with localcontext(Context(prec=30)):
        per_cm = Decimal(_CM_UM) / step_um
        root = Decimal(2) ** (Decimal(1) / octave)
        ahead = [Decimal(2) ** _FOLD]
        for _ in range((1 << bits) - 1):
            ahead.append(ahead[-1] * root)
        centimetres = [float(power - 1) for power in ahead]
        nearest = [int((power - 1) * per_cm + Decimal("0.5")) for power in ahead]
        # A whole octave is a whole number of centimetres, and may lie between two steps: the larger one is taken.
        nearest[::octave] = [(2 * _CM_UM * ((1 << exponent) - 1) + step_um) // (2 * step_um)
                             for exponent in range(_FOLD, _FOLD + len(nearest[::octave]))]  # fmt: skip
        value = [min(range_steps, top) for range_steps in nearest]
        folded = [float(octave * (_FOLD - (1 + Decimal(d) / per_cm).ln() / Decimal(2).ln()))
                  for d in range(min(top + 1, math.ceil((2**_FOLD - 1) * per_cm)))]  # fmt: skip
    values = np.arange(top + 1, dtype=np.float64) / steps_per_cm
    sample = np.interp(values, np.array(centimetres), np.arange(len(centimetres), dtype=np.float64))
    sample[: len(folded)] = np.abs(np.array(folded))
    return Mapping(sample.astype(np.float32), np.array(value, np.int32))


@lru_cache(maxsize=8)
def mapping_of(name: MappingName, bits: int, top: int, step_um: int = _CANVAS_STEP_UM) -> Mapping:
    """Tables of a mapping onto samples of 8, 10 or 12 bits; top: the largest canvas value; step_um: a step of it."""
    peak = (1 << bits) - 1
    levels = np.arange(peak + 1, dtype=np.int64)
    values = np.arange(top + 1, dtype=np.float64)
    if name == "linear":
        return Mapping(
            (values * (peak / top)).astype(np.float32), ((2 * levels * top + peak) // (2 * peak)).astype("i4")
        )
    if name == "sqrt":
        square = (2 * levels**2 * top + peak**2) // (2 * peak**2)
        return Mapping((np.sqrt(values / top) * peak).astype(np.float32), square.astype(np.int32))
    if name == "paper":
        return _paper(bits, top, step_um)
    exact = _log_values(top, peak, step_um)
    rounded = np.array([int(value + Decimal("0.5")) for value in exact], np.int32)
    sample = np.interp(values, np.array([float(value) for value in exact]), levels)
    return Mapping(sample.astype(np.float32), np.minimum(rounded, top).astype(np.int32))


def top_of(name: MappingName, farthest: int, scale: Scale = CANVAS) -> int:
    """The `top` for an image whose largest canvas value is `farthest`: itself, but `log`, whose tables take long, has
    one for an HDL-64E, and four an octave for others."""
    if name != "log":
        return max(farthest, 1)
    if scale == CANVAS:
        return MAX_VALUE
    below = max(farthest.bit_length() - 3, 0)
    return max(min(-(-farthest >> below) << below, scale.most), 1)
