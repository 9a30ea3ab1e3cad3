"""JPEG files of one component, 8 or 12 bits: written from samples, and checked before they are decoded.

There are two ways to write. `even` is ours: all coefficients have the same step, which gives the least mean squared
error and saves a fifth of the bits against libjpeg's tables, which are made for the eye. `libjpeg` is the way of the
papers: libjpeg's tables, written by imagecodecs. Any JPEG decoder for 12 bits reads both.
"""

from __future__ import annotations

import struct
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from lidarcodec import _native
from lidarcodec.errors import SectionError
from lidarcodec.ranges.image.holes import filled_blocks

Tables = Literal["even", "libjpeg"]
Samples = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

BLOCK: Final = 8
EVEN_BASE: Final = 16
"""Step of `even` at quality 50, in samples, as that of a block's mean in libjpeg's table."""
_LARGEST_STEP: Final = 0xFFFF
_LUMINANCE: Final = np.array(
    [16, 11, 10, 16, 24, 40, 51, 61, 12, 12, 14, 19, 26, 58, 60, 55, 14, 13, 16, 24, 40, 57, 69, 56,
     14, 17, 22, 29, 51, 87, 80, 62, 18, 22, 37, 56, 68, 109, 103, 77, 24, 35, 55, 64, 81, 104, 113, 92,
     49, 64, 78, 87, 103, 121, 120, 101, 72, 92, 95, 98, 112, 100, 103, 99], np.float64)  # fmt: skip
"""ITU-T T.81, table K.1: what libjpeg scales."""
_SKIPPED: Final = frozenset({0xDB, 0xC4, *range(0xE0, 0xF0), 0xFE})
"""Markers between start and scan whose segments the decoder may read: steps, Huffman tables, APPn, comment."""
_SAMPLES_PER_BYTE: Final = 256
"""A block of 64 samples takes two bits or more. A shorter file is damaged or hostile."""
_SEQUENTIAL: Final = (0xC0, 0xC1)


def scale_of(quality: float) -> float:
    """Percentage by which libjpeg scales its tables at a quality from 1 to 100."""
    return 5000 / quality if quality < 50 else 200 - 2 * quality


def steps_of(tables: Tables, quality: float, finer: float = 1.0) -> npt.NDArray[np.uint16]:
    """(64,) uint16, quantiser step of each coefficient, in samples, row by row.

    finer: how much finer samples are than those of the whole range: `even` keeps its steps in metres, so that a quality
    means the same error whatever the farthest return is; libjpeg counts in samples.
    """
    scale = scale_of(quality)
    if tables == "even":
        return np.full(64, min(max(1, round(EVEN_BASE * scale / 100 * finer)), _LARGEST_STEP), np.uint16)
    return np.maximum(1, (_LUMINANCE * scale + 50) // 100).astype(np.uint16)


def write_jpeg(samples: Samples, known: Mask, bits: int, tables: Tables, quality: float, finer: float) -> bytes:
    """A JPEG of samples; known: which of them are returns. Sides are multiples of 8, samples 0..2^bits - 1.

    4 ms for 64 x 2264.
    """
    if tables == "libjpeg":
        quality = round(quality)  # imagecodecs takes whole numbers only
    steps = steps_of(tables, quality, finer)
    filled = filled_blocks(samples, known, steps)
    if tables == "even":
        return bytes(_native.write_jpeg(filled, steps, bits))
    import imagecodecs

    whole = np.rint(np.clip(filled, 0, (1 << bits) - 1)).astype(np.uint16)
    if bits == 12:
        return bytes(imagecodecs.jpeg8_encode(whole, level=int(quality), bitspersample=12))
    return bytes(imagecodecs.jpeg8_encode(whole.astype(np.uint8), level=int(quality), optimize=True))


def check_jpeg(data: bytes, rows: int, width: int, bits: int) -> None:
    """Checks the file's header: only an image with these sides may be decoded.

    Raises SectionError.
    """
    if data[:2] != b"\xff\xd8":
        raise SectionError("a JPEG that does not begin as one")
    at, seen = 2, False
    while True:
        if len(data) < at + 4 or data[at] != 0xFF:
            raise SectionError(f"a JPEG without a marker at byte {at}")
        marker, size = data[at + 1], int.from_bytes(data[at + 2 : at + 4], "big")
        segment = data[at + 4 : at + 2 + size]
        if size < 2 or len(segment) != size - 2:
            raise SectionError(f"a JPEG that ends within a segment at byte {at}")
        if marker == 0xDA:
            break
        if marker in _SEQUENTIAL and not seen:
            if segment[:6] != struct.pack(">BHHB", bits, rows, width, 1) or len(segment) != 9:
                raise SectionError(f"a JPEG that is not one component of {width} x {rows} samples of {bits} bits")
            seen = True
        elif marker not in _SKIPPED:
            raise SectionError(f"a JPEG with marker {marker:#04x}: only sequential ones are read")
        at += 2 + size
    if not seen:
        raise SectionError("a JPEG that says no size before its scan")
    if (len(data) - at) * _SAMPLES_PER_BYTE < rows * width:
        raise SectionError(f"a JPEG of {width} x {rows} samples in {len(data) - at} bytes")


def read_jpeg(data: bytes, rows: int, width: int, bits: int) -> npt.NDArray[np.uint16]:
    """(rows, width) uint16, samples of a JPEG.

    Raises SectionError if it is damaged, or anything but that.
    """
    import imagecodecs

    check_jpeg(data, rows, width, bits)
    try:
        samples = imagecodecs.jpeg8_decode(data)
    except MemoryError:  # not the fault of the data
        raise
    except Exception as error:
        raise SectionError(f"damaged JPEG: {error}") from None
    wanted = np.uint16 if bits > BLOCK else np.uint8
    if samples is None or samples.shape != (rows, width) or samples.dtype != wanted:
        raise SectionError("a JPEG that is not what its header says")
    if bits > BLOCK and int(samples.max()) >= 1 << bits:
        raise SectionError(f"a JPEG with samples beyond {bits} bits")
    return np.asarray(samples, np.uint16)
