"""The INTENSITY section: intensities of the returns in row order, and those of the no-return cells if any is not zero.

Forms (docs/wire-format.md): 0 RETURNS, one zstd frame; 1 ALL_FIRED, u32 length of the first of two zstd frames, the
second for fired cells without a return; 2 LEVELS, levels - 1 as u8, one zstd frame of level numbers of the returns.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.codecs.zstd_frames import compress, decompress
from lidarcodec.errors import SectionError

FORM_RETURNS: Final = 0
FORM_ALL_FIRED: Final = 1
FORM_LEVELS: Final = 2
_LEVEL: Final = 3
LOSSLESS_LEVELS: Final = 256

Bytes = npt.NDArray[np.uint8]
Mask = npt.NDArray[np.bool_]


def level_of(intensity: Bytes, levels: int) -> Bytes:
    """Number of the nearest of `levels` evenly spaced levels of 0..255, for each intensity."""
    table = (np.arange(256, dtype=np.uint32) * (levels - 1) + 127) // 255
    return table.astype(np.uint8)[intensity]


def intensity_of(level: Bytes, levels: int) -> Bytes:
    """Intensity of each level number.

    Raises SectionError for a number that is no level.
    """
    if not 2 <= levels <= LOSSLESS_LEVELS:
        raise SectionError(f"{levels} intensity levels: 2 to 256 are possible")
    if len(level) and int(level.max()) >= levels:
        raise SectionError(f"intensity level {int(level.max())} of {levels}")
    table = (np.arange(levels, dtype=np.uint32) * 255 + (levels - 1) // 2) // (levels - 1)
    return table.astype(np.uint8)[level]


def encode_intensity(intensity: Bytes, valid: Mask, cells: Mask, levels: int, reduced: bool) -> bytes | None:
    """Bytes of the section, or None when intensity is off (`levels` 0).

    intensity: (64, W) uint8; valid: (64, W), the returns that are sent; cells: (64, W), those that fired;
    levels: 256 = lossless; reduced: intensities without a return are then not sent.
    """
    if not levels:
        return None
    returns = intensity[valid]
    if levels < LOSSLESS_LEVELS:
        return bytes([FORM_LEVELS, levels - 1]) + compress(level_of(returns, levels).tobytes(), _LEVEL)
    first = compress(returns.tobytes(), _LEVEL)
    others = intensity[cells & ~valid] if not reduced else returns[:0]
    if not others.any():
        return bytes([FORM_RETURNS]) + first
    return bytes([FORM_ALL_FIRED]) + len(first).to_bytes(4, "little") + first + compress(others.tobytes(), _LEVEL)


def decode_intensity(data: bytes | None, valid: Mask, cells: Mask) -> Bytes:
    """(64, W) uint8; zeros where nothing was sent.

    Raises SectionError.
    """
    image = np.zeros(valid.shape, np.uint8)
    if data is None:
        return image
    count = int(np.count_nonzero(valid))
    form = data[0] if data else -1
    if form == FORM_RETURNS:
        image[valid] = np.frombuffer(decompress(data[1:], count), np.uint8)
    elif form == FORM_LEVELS and len(data) > 1:
        image[valid] = intensity_of(np.frombuffer(decompress(data[2:], count), np.uint8), data[1] + 1)
    elif form == FORM_ALL_FIRED:
        split = 5 + int.from_bytes(data[1:5], "little")
        others = cells & ~valid
        image[valid] = np.frombuffer(decompress(data[5:split], count), np.uint8)
        image[others] = np.frombuffer(decompress(data[split:], int(np.count_nonzero(others))), np.uint8)
    else:
        raise SectionError(f"an intensity section of {len(data)} bytes, form {form}")
    return image
