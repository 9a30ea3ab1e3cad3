"""Ranges of a sector given those of its base, as bytes and back, on the native core (native/src/layers)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec import _native
from lidarcodec.entropy.mask_coder import frame_geometry
from lidarcodec.errors import SectionError
from lidarcodec.frame import Frame
from lidarcodec.ranges.image.canvas import level_offsets
from lidarcodec.units import LASERS

Ranges = npt.NDArray[np.uint16]


class LayerSteps(NamedTuple):
    """base, fine: quantiser widths in range steps, odd, fine below base; turn: columns in a full turn, 0 to 65535"""

    base: int
    fine: int
    turn: int


def encode_refined(ranges: Ranges, base: Frame, steps: LayerSteps) -> bytes:
    """Bytes of ranges; 40 ms for 120,000 returns.

    ranges: (64, W) uint16, at most half a step of the base from its ranges; base: the same columns, as decoded
    Raises SectionError if a range is further from its base, or shapes do not fit.
    """
    if ranges.shape != base.range.shape or ranges.dtype != np.uint16:
        raise SectionError(f"ranges are {ranges.dtype}{ranges.shape}, not uint16({LASERS}, {base.width})")
    return _native.encode_refinement(np.ascontiguousarray(ranges), *_given(base), *steps)


def decode_refined(data: bytes, base: Frame, steps: LayerSteps) -> Ranges:
    """(64, W) uint16, the ranges at the returns of the base; 0 elsewhere.

    Raises SectionError or TruncatedError.
    """
    return _native.decode_refinement(data, *_given(base), *steps)


def _given(
    base: Frame,
) -> tuple[Ranges, npt.NDArray[np.uint8], npt.NDArray[np.uint8], npt.NDArray[np.int32], npt.NDArray[np.int32]]:
    return (base.range_u16, *frame_geometry(base.fired, base.sensor), level_offsets(base.sensor))
