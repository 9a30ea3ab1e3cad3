"""JPEG XL codestreams of one grey channel of 16 bits, lossless: written, and checked before they are decoded.

imagecodecs wraps a codestream into a container that only says "level 10"; it is taken out again, because the bare
codestream is a file of its own, smaller by 49 bytes, and leaves a hostile sender fewer places to hide something.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import LidarCodecError, SectionError

Ranges = npt.NDArray[np.uint16]

_CODESTREAM: Final = b"\xff\x0a"
_SIDE_BITS: Final = (9, 13, 18, 30)
_RATIOS: Final = ((1, 1), (12, 10), (4, 3), (3, 2), (16, 9), (5, 4), (2, 1))
_HEADER_BYTES: Final = 16


def write_jxl(image: Ranges, effort: int) -> bytes:
    """The codestream of a (H, W) image.

    Raises LidarCodecError if the library writes something else.
    """
    import imagecodecs

    data = bytes(imagecodecs.jpegxl_encode(image, lossless=True, effort=effort, numthreads=1))
    if data[:2] == _CODESTREAM:
        return data
    at, parts = 0, []
    while at + 8 <= len(data):
        size, kind = int.from_bytes(data[at : at + 4], "big") or len(data) - at, data[at + 4 : at + 8]
        if size < 8:  # a box of 64-bit length, or none at all
            break
        body = data[at + 8 : at + size]
        parts += [body] if kind == b"jxlc" else [body[4:]] if kind == b"jxlp" else []
        at += size
    codestream = b"".join(parts)
    if codestream[:2] != _CODESTREAM:
        raise LidarCodecError("imagecodecs wrote a JPEG XL file without a codestream")
    return codestream


class _Bits:
    """The first bits of a codestream, lowest bit of each byte first; zeros beyond the end."""

    def __init__(self, data: bytes) -> None:
        self._rest = int.from_bytes(data[:_HEADER_BYTES], "little")

    def take(self, count: int) -> int:
        value = self._rest & ((1 << count) - 1)
        self._rest >>= count
        return value

    def side(self) -> int:
        return 1 + self.take(_SIDE_BITS[self.take(2)])


def check_jxl(data: bytes, rows: int, width: int) -> None:
    """Checks the codestream's header (ISO/IEC 18181-1, annex D): its sides, and that it has no preview, no
    animation, no other orientation.

    Raises SectionError.
    """
    if data[:2] != _CODESTREAM:
        raise SectionError("a JPEG XL codestream that does not begin as one")
    bits = _Bits(data[2:])
    in_eights = bits.take(1)
    found_rows = 8 * (1 + bits.take(5)) if in_eights else bits.side()
    ratio = bits.take(3)
    if ratio:
        across, down = _RATIOS[ratio - 1]
        found_width = found_rows * across // down
    else:
        found_width = 8 * (1 + bits.take(5)) if in_eights else bits.side()
    if (found_rows, found_width) != (rows, width):
        raise SectionError(f"a JPEG XL image of {found_width} x {found_rows}, not {width} x {rows}")
    if bits.take(1) or bits.take(1):
        raise SectionError("a JPEG XL image of 8 bits, or with extra fields")


def read_jxl(data: bytes, rows: int, width: int) -> Ranges:
    """(rows, width) uint16 samples of a codestream.

    Raises SectionError if it is damaged, or anything but that.
    """
    import imagecodecs

    check_jxl(data, rows, width)
    image = np.zeros((rows, width), np.uint16)
    try:
        came = imagecodecs.jpegxl_decode(data, numthreads=1, out=image)
    except MemoryError:  # not the fault of the data
        raise
    except Exception as error:
        raise SectionError(f"damaged JPEG XL: {error}") from None
    if came is not image:
        raise SectionError("a JPEG XL codestream that is not what its header says")
    return image
