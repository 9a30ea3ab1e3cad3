"""The INTENSITY section: intensities of the returns in row order, and those of the no-return cells if any is not zero.

Forms (docs/wire-format.md): 0 RETURNS, coded bytes; 1 ALL_FIRED, u32 length of the coded bytes, these, and one zstd
frame for the fired cells without a return; 2 LEVELS, levels - 1 as u8, coded level numbers of the returns.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.codecs.neighbour import decode_bytes, encode_bytes
from lidarcodec.codecs.zstd_frames import compress, decompress
from lidarcodec.errors import SectionError

FORM_RETURNS: Final = 0
FORM_ALL_FIRED: Final = 1
FORM_LEVELS: Final = 2
LOSSLESS_LEVELS: Final = 256
_LEVEL: Final = 3

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
    if int(level.max(initial=0)) >= levels:
        raise SectionError(f"intensity level {int(level.max())} of {levels}")
    table = (np.arange(levels, dtype=np.uint32) * 255 + (levels - 1) // 2) // (levels - 1)
    return table.astype(np.uint8)[level]


def encode_intensity(intensity: Bytes, valid: Mask, cells: Mask, levels: int, reduced: bool) -> bytes | None:
    """Bytes of the section, or None when intensity is off (`levels` 0); 1 ms for 120,000 returns.

    intensity: (64, W) uint8; valid: (64, W), the returns that are sent; cells: (64, W), those that fired;
    levels: 256 = lossless; reduced: intensities without a return are then not sent.
    """
    if not levels:
        return None
    returns = intensity[valid]
    if levels < LOSSLESS_LEVELS:
        return bytes([FORM_LEVELS, levels - 1]) + encode_bytes(level_of(returns, levels))
    coded = encode_bytes(returns)
    others = returns[:0] if reduced else intensity[cells & ~valid]
    if not others.any():
        return bytes([FORM_RETURNS]) + coded
    return bytes([FORM_ALL_FIRED]) + len(coded).to_bytes(4, "little") + coded + compress(others.tobytes(), _LEVEL)


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
        image[valid] = decode_bytes(data[1:], count)
    elif form == FORM_LEVELS and len(data) > 1:
        image[valid] = intensity_of(decode_bytes(data[2:], count), data[1] + 1)
    elif form == FORM_ALL_FIRED:
        split = 5 + int.from_bytes(data[1:5], "little")
        others = cells & ~valid
        image[valid] = decode_bytes(data[5:split], count)
        image[others] = np.frombuffer(decompress(data[split:], int(np.count_nonzero(others))), np.uint8)
    else:
        raise SectionError(f"an intensity section of {len(data)} bytes, form {form}")
    return image
