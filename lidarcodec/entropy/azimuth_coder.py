"""Azimuth coder: the rotation positions of a frame, without loss: differences, coded by the lengths of the last runs.

About 50 bytes for the 2088 columns of a KITTI frame. The format is docs/wire-format-sections.md, section "azimuth".

>>> import numpy as np
>>> azimuth, fired = np.tile(np.arange(0, 1800, 18, dtype=np.uint16), (2, 1)), np.ones((2, 100), np.bool_)
>>> bool((decode_azimuth(encode_azimuth(azimuth, fired), 100)[0] == azimuth).all())
True
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from lidarcodec import _native
from lidarcodec.errors import SectionError
from lidarcodec.units import MAX_COLUMNS


def encode_azimuth(azimuth: npt.NDArray[np.uint16], fired: npt.NDArray[np.bool_]) -> bytes:
    """Bytes of a frame's rotations and of what fired; 0.1 ms a frame.

    azimuth: (2, W) uint16, 0.01 degree, upper and lower; fired: (2, W) bool.

    Raises SectionError if a value is over 35999, or a half that did not fire does not repeat the other.
    """
    width = azimuth.shape[-1] if azimuth.ndim == 2 else -1
    if azimuth.dtype != np.uint16 or azimuth.shape != (2, width) or width > MAX_COLUMNS:
        raise SectionError(f"azimuth is {azimuth.dtype}{azimuth.shape}, not uint16(2, W) with W up to {MAX_COLUMNS}")
    if fired.dtype != np.bool_ or fired.shape != azimuth.shape:
        raise SectionError(f"fired is {fired.dtype}{fired.shape}, not bool{azimuth.shape}")
    return _native.encode_azimuth(np.ascontiguousarray(azimuth), np.ascontiguousarray(fired).view(np.uint8))


def decode_azimuth(data: bytes, width: int) -> tuple[npt.NDArray[np.uint16], npt.NDArray[np.bool_]]:
    """azimuth (2, W) uint16 and fired (2, W) bool; 0.1 ms a frame.

    Raises SectionError or TruncatedError.
    """
    if not 0 <= width <= MAX_COLUMNS:
        raise SectionError(f"a frame of {width} columns: the limit is {MAX_COLUMNS}")
    azimuth, fired = _native.decode_azimuth(data, width)
    return azimuth, fired.view(np.bool_)


def columns_in_turn(azimuth: npt.NDArray[np.uint16]) -> int | None:
    """Columns in a full turn at the mean step of a frame's rotations, (2, W) uint16; gaps are left out.

    None if the sensor does not turn. It tells `encode_mask` how the rows lie to each other.
    """
    return _native.columns_in_turn(np.ascontiguousarray(azimuth[0])) or None
