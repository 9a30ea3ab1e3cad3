"""Uniform quantisation of ranges, with a bound that holds at every return.

With an odd step s a range x has the index q = (x + s // 2) // s and decodes as q * s, at most (s - 1) / 2 range steps
away. Both ends differ. Index 0 would decode as 0, which is no return, so it decodes as the middle of its ranges. The
largest index decodes as at most 65535. The bound holds at both.

>>> indices = quantise(np.array([1, 5, 6, 17, 65535], np.uint16), 11)
>>> indices.tolist(), reconstruct(indices, 11).tolist()
([0, 0, 1, 2, 5958], [3, 3, 11, 22, 65535])
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import SectionError
from lidarcodec.frame import Frame
from lidarcodec.settings import MAX_BOUND_M, step_of

MAX_RANGE: Final = 65535
MAX_STEP: Final = step_of(MAX_BOUND_M)


def check_step(step: int) -> int:
    """The step itself, if it is an odd number of native units up to 20001 (20 m).

    Raises SectionError otherwise.
    """
    if not (1 <= step <= MAX_STEP and step % 2):
        raise SectionError(f"range step {step} is not an odd number from 1 to {MAX_STEP}")
    return step


def quantise(ranges: npt.NDArray[np.uint16], step: int) -> npt.NDArray[np.uint16]:
    """Indices of non-zero ranges, same shape, 0..(65535 + step // 2) // step; for step 1 the ranges themselves."""
    if step == 1:
        return ranges
    return ((ranges.astype(np.uint32) + step // 2) // np.uint32(step)).astype(np.uint16)


def reconstruct(indices: npt.NDArray[np.uint16], step: int) -> npt.NDArray[np.uint16]:
    """Ranges of indices, same shape, 1..65535 and never more than (step - 1) / 2 from what was quantised.

    Raises SectionError for an index that no range has.
    """
    check_step(step)
    if not len(indices):
        return indices
    top = (MAX_RANGE + step // 2) // step
    if step == 1:
        if not indices.all():
            raise SectionError("a return of range 0")
        return indices
    if int(indices.max()) > top:
        raise SectionError(f"range index {int(indices.max())} beyond {top}, the last of step {step}")
    exact = indices.astype(np.uint32) * np.uint32(step)
    ranges: npt.NDArray[np.uint16] = np.minimum(exact, MAX_RANGE).astype(np.uint16)
    ranges[indices == 0] = (step // 2 + 1) // 2
    return ranges


def as_decoded(
    ranges: npt.NDArray[np.uint16], valid: npt.NDArray[np.bool_], step: int, levels: npt.NDArray[np.int32]
) -> npt.NDArray[np.uint16]:
    """(64, W) uint16, the ranges that a decoder gets of ones that were rounded on a common scale; 0 outside of `valid`.

    ranges: (64, W) uint16; valid: (64, W) bool; step: odd; levels: (64,) int32, what is added to each row
    """
    if step == 1:
        return np.where(valid, ranges, np.uint16(0))
    added = levels[:, None]
    cells = (ranges.astype(np.int32) + (added + step // 2)) // np.int32(step)
    return np.where(valid, (cells * np.int32(step) - added).clip(1, 65535), 0).astype(np.uint16)


def requantised(frame: Frame, step: int) -> npt.NDArray[np.uint16]:
    """(64, W) uint16, the ranges that a decoder gets of `quantise` of the frame's valid returns; 0 elsewhere."""
    ranges = np.zeros(frame.range.shape, np.uint16)
    ranges[frame.valid] = reconstruct(quantise(frame.range_u16[frame.valid], step), step)
    return ranges
