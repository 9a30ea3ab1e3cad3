"""What suits a series of whole numbers best, in Python: the same as native/src/bits/number_series.cpp, for tests.

>>> import numpy as np
>>> form, line, left, cost = best_form(np.array([7, 295, 583, 872, 1159], np.int64))
>>> form, line, left.tolist(), cost
(<Form.LEVEL: 0>, Line(level=7, rate=295082), [0, 0, 0, 1, 0], 256)
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lidarcodec.entropy.number_series import (
    MOST_LEVEL,
    MOST_RATE,
    Form,
    Line,
    Series,
    centred,
    differences,
    residuals,
)


def best_form(values: Series, modulus: int = 0) -> tuple[Form, Line, Series, int]:
    """Form and line that leave the cheapest residuals, those, and what they cost; centred if a modulus is given."""

    def brought_in(series: Series) -> Series:
        return centred(series, modulus) if modulus else series

    steps = brought_in(differences(values, 1)[1:])
    fits = []
    for form in Form:
        line = _line(values, steps, form)
        left = brought_in(residuals(values, form, line))
        fits.append((form, line, left, sum(map(_cost, left.tolist()))))
    return min(fits, key=lambda fit: fit[3])


def best_period(types: Sequence[int], longest: int) -> int:
    """Period that predicts most types by those one period before; longer ones cost one each."""
    costs = [
        period + sum(types[i] != types[i - period] for i in range(period, len(types)))
        for period in range(1, longest + 1)
    ]
    return costs.index(min(costs)) + 1


def _line(values: Series, steps: Series, form: Form) -> Line:
    if not len(steps) or form is Form.ALTERNATING:
        return Line(int(values[0]) if len(values) else 0, 0)
    if form is not Form.LEVEL:
        return Line(int(values[0]), _bounded(1024 * _median(steps), MOST_RATE))
    path = np.cumsum(np.concatenate([np.zeros(1, np.int64), steps]))
    half = len(path) // 2  # from the mean of the first half to that of the second
    rise = int(path[-half:].sum()) - int(path[:half].sum())
    rate = _bounded(rise * 1024 // (half * (len(path) - half)), MOST_RATE)
    level = int(values[0]) + _median(path - Line(0, rate).at(len(path)))
    return Line(_bounded(level, MOST_LEVEL), rate)


def _cost(value: int) -> int:
    """256ths of a bit: log2(1 + |x|), by a straight line within each octave."""
    size = 1 + abs(value)
    octave = size.bit_length() - 1
    return octave << 8 | size << 63 - octave >> 55 & 255


def _median(values: Series) -> int:
    return int(np.sort(values)[len(values) // 2])


def _bounded(value: int, limit: int) -> int:
    return max(-limit, min(limit, value))
