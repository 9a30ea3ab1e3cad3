"""The mask coder of streams with memory: a sixth to a fifth less than `mask_coder` needs, for 2 ms more a frame.

It looks at which directions returned in the last turns and at what the ranges are expected to be, and learns from one
frame to the next. So one at each end of a stream has to see the same masks, from one that begins on. The format is
docs/wire-format-sections.md, section "masks in streams".

>>> import numpy as np
>>> azimuth, fired = np.tile(np.arange(0, 360, 18, dtype=np.uint16), (2, 1)), np.ones((2, 20), bool)
>>> mask, beams = np.arange(64 * 20).reshape(64, 20) % 7 > 0, np.zeros((6, 64), np.int32)
>>> sender, receiver = MaskStream(), MaskStream()
>>> bool((receiver.decode(sender.encode(mask, azimuth, fired, beams), azimuth, fired, beams) == mask).all())
True
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec import _native
from lidarcodec.errors import SectionError

STREAM_KINDS: Final = (6, 7)
"""First bytes of sections that only such a coder reads: one that begins, one that goes on."""
_NOTHING: Final = np.zeros((64, 0), np.uint16)
_STILL: Final = np.array([1 << 30, 0, 0, 0, 1 << 30, 0, 0, 0, 1 << 30, 0, 0, 0], np.int32)

Mask = npt.NDArray[np.bool_]
Azimuth = npt.NDArray[np.uint16]
Ranges = npt.NDArray[np.uint16]
Numbers = npt.NDArray[np.int32]


class MaskStream:
    """Codes the masks of a stream. After an error only `forget` may be called.

    beams: (6, 64) int32, of each row block (0 upper, 1 lower), rotation and elevation, steps of 1e-8 rad; three more
    expected: (64, W) uint16, ranges, 0 = nothing; None: nothing anywhere
    motion: (12,) int32, with which they were expected: rotation (2^-30) and translation (1/16 mm) since the last turn
    """

    def __init__(self, native: _native.MaskStream | None = None) -> None:
        self._native: Final = native or _native.MaskStream()

    def copy(self) -> MaskStream:
        """Another one, which goes on from the same state."""
        return MaskStream(self._native.copy())

    def forget(self) -> None:
        """Forget everything: the next mask begins."""
        self._native.forget()

    def encode(
        self,
        mask: Mask,
        azimuth: Azimuth,
        fired: Mask,
        beams: Numbers,
        expected: Ranges | None = None,
        motion: Numbers | None = None,
    ) -> bytes:
        """Bytes of a mask. mask: (64, W) bool; azimuth: (2, W) uint16, 0.01 degree; fired: (2, W) bool.

        A mask without returns, or of nothing but returns, costs a byte and is not remembered.
        Raises SectionError if shapes do not fit, an azimuth is not below 36000, or a cell is set that was not fired.
        """
        if mask.dtype != np.bool_:
            raise SectionError(f"a mask is {mask.dtype}, not bool")
        view = _view(azimuth, fired, beams, expected, motion)
        return self._native.encode(np.ascontiguousarray(mask).view(np.uint8), *view)

    def decode(
        self,
        data: bytes,
        azimuth: Azimuth,
        fired: Mask,
        beams: Numbers,
        expected: Ranges | None = None,
        motion: Numbers | None = None,
    ) -> Mask:
        """(64, W) bool, the mask of a section of one of STREAM_KINDS; all else as it was coded with.

        Raises SectionError, also for one that goes on from masks that were not decoded here, or TruncatedError.
        """
        return self._native.decode(data, *_view(azimuth, fired, beams, expected, motion)).view(np.bool_)


def _view(
    azimuth: Azimuth, fired: Mask, beams: Numbers, expected: Ranges | None, motion: Numbers | None
) -> tuple[Azimuth, npt.NDArray[np.uint8], Numbers, Ranges, Numbers]:
    if fired.dtype != np.bool_:
        raise SectionError(f"fired is {fired.dtype}, not bool")
    return (
        np.ascontiguousarray(azimuth),
        np.ascontiguousarray(fired).view(np.uint8),
        beams,
        _NOTHING if expected is None else np.ascontiguousarray(expected),
        _STILL if motion is None else motion,
    )
