"""Values for cells without a return that cost an image codec few bits. The decoder discards them.

JPEG XL predicts by a clamped gradient, PNG from the left. With the values that it predicts itself, each needs 0.3 bit
a point less than with those that the other predicts.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec import _native

Mask = npt.NDArray[np.bool_]
Ranges = npt.NDArray[np.uint16]
Samples = npt.NDArray[np.float32]

ROUNDS: Final = 3
"""Projections of each block with holes: three more would save 0.5 % and take 2 ms."""


def filled_blocks(samples: Samples, known: Mask, steps: npt.NDArray[np.uint16]) -> Samples:
    """(H, W) float32, for JPEG: blocks of 8 x 8 that need few coefficients when quantised with these 64 steps.

    H and W are multiples of 8. 2 ms for 64 x 2264.
    """
    return _native.fill_blocks(samples, known.view(np.uint8), steps, ROUNDS)


def filled_lines(samples: Samples, known: Mask) -> Samples:
    """(H, W) float32, for video: interpolated along the row; blocks without samples have one value.

    H and W are multiples of 8.
    """
    return _native.fill_blocks(samples, known.view(np.uint8), np.ones(64, np.uint16), 0)


def filled_predicted(values: Ranges, known: Mask) -> Ranges:
    """(H, W) uint16, for codecs that predict from left, above and above left: each hole is what the codec predicts."""
    return _native.fill_predicted(values, known.view(np.uint8))


def filled_left(values: Ranges, known: Mask) -> Ranges:
    """(H, W) uint16, for codecs that predict from the left: each hole repeats the last return of its row."""
    last = np.where(known, np.arange(values.shape[1], dtype=np.int32), 0)
    np.maximum.accumulate(last, axis=1, out=last)
    return np.take_along_axis(np.where(known, values, np.uint16(0)), last, axis=1)
