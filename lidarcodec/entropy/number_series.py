"""Series of whole numbers, such as time stamps, turned into small ones and back.

A series is seen as a straight line and what is left over: the distances from the line (LEVEL), the first or second
differences of these, or the differences to the number before the last. All arithmetic is modulo 2^64, so every form
can be undone exactly on any input; form and line are the encoder's choice.

>>> import numpy as np
>>> stamps = np.array([7, 295, 583, 872, 1159], np.int64)
>>> residuals(stamps, Form.LEVEL, Line(level=7, rate=288 * 1024)).tolist()
[0, 0, 0, 1, 0]
>>> residuals(stamps, Form.FIRST, Line(level=7, rate=288 * 1024)).tolist()
[0, 0, 0, 1, -1]
>>> series(np.array([0, 0, 0, 1, 0]), Form.LEVEL, Line(level=7, rate=288 * 1024)).tolist()
[7, 295, 583, 872, 1159]
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Series = npt.NDArray[np.int64]
MOST_LEVEL = 1 << 62
MOST_RATE = 1 << 45
"""Limits of a line, so that no sum of it overflows."""


class Form(IntEnum):
    """How a series is turned into residuals; the first number is always kept."""

    LEVEL = 0
    FIRST = 1
    SECOND = 2
    ALTERNATING = 3


class Line(NamedTuple):
    """A straight line of whole numbers: `level` at place 0, rising by `rate` / 1024 a place, rounded down."""

    level: int
    rate: int

    def at(self, count: int) -> Series:
        """(count,) int64, the line at places 0, 1, 2 ..."""
        return np.int64(self.level) + (np.arange(count, dtype=np.int64) * np.int64(self.rate) >> np.int64(10))


def differences(values: Series, lag: int) -> Series:
    """(N,) int64 difference of each number to the one `lag` before it, modulo 2^64; the first `lag` as they are."""
    residuals = values.copy()
    residuals[lag:] -= values[:-lag]
    return residuals


def sums(residuals: Series, lag: int) -> Series:
    """(N,) int64, undoes `differences`."""
    count = len(residuals)
    rows = -(-count // lag)
    table = np.zeros((rows, lag), np.int64)
    table.ravel()[:count] = residuals
    return np.cumsum(table, axis=0).ravel()[:count]


def centred(values: Series, modulus: int) -> Series:
    """(N,) int64 in [-modulus // 2, modulus - modulus // 2), the same modulo `modulus`."""
    low = modulus // 2
    return (values + low) % modulus - low


def zigzag(values: Series) -> npt.NDArray[np.uint64]:
    """(N,) uint64: 0, -1, 1, -2, 2 ... as 0, 1, 2, 3, 4 ..."""
    return ((values << np.int64(1)) ^ (values >> np.int64(63))).view(np.uint64)


def unzigzag(numbers: npt.NDArray[np.uint64]) -> Series:
    """(N,) int64, undoes `zigzag`."""
    return (numbers >> np.uint64(1)).view(np.int64) ^ -(numbers & np.uint64(1)).view(np.int64)


def residuals(values: Series, form: Form, line: Line) -> Series:
    """(N,) int64, what is left of a series: small numbers if `form` and `line` suit it."""
    off = values - line.at(len(values))
    if form is Form.LEVEL:
        return off
    if form is Form.ALTERNATING:
        return differences(off, 2)
    steps = differences(off, 1)
    if form is Form.SECOND:
        steps[1:] = differences(steps[1:], 1)
    return steps


def series(left: Series, form: Form, line: Line) -> Series:
    """(N,) int64, undoes `residuals`."""
    if form is Form.LEVEL:
        off = left
    elif form is Form.ALTERNATING:
        off = sums(left, 2)
    else:
        steps = left.copy()
        if form is Form.SECOND:
            steps[1:] = sums(left[1:], 1)
        off = sums(steps, 1)
    return off + line.at(len(left))
