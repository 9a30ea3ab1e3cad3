"""NAL units of H.264 (ITU-T H.264, 7.3 and annex B): the content of an access unit, checked before FFmpeg decodes it.

>>> from lidarcodec.ranges.video.h264_units import split_units
>>> [unit.hex() for unit in split_units(b"\\0\\0\\0\\1\\x67\\x64\\0\\0\\1\\x68")]
['6764', '68']
"""

from __future__ import annotations

from typing import Final

from lidarcodec.errors import SectionError

SLICE: Final = 1
IDR_SLICE: Final = 5
REMARKS: Final = 6
SEQUENCE: Final = 7
PICTURE: Final = 8

_START: Final = b"\0\0\1"
_IDR_UNITS: Final = (SEQUENCE, PICTURE, IDR_SLICE)
_P_UNITS: Final = (SLICE,)
_HIGH_PROFILES: Final = (100, 110)
"""High and High 10: the ones with pictures of one plane."""
_MOST_REFERENCES: Final = 16
_LONGEST_PARAMETERS: Final = 512


def split_units(data: bytes) -> list[bytes]:
    """NAL units of an access unit in the byte stream format.

    Raises SectionError if it does not begin with one.
    """
    parts = data.split(_START)
    if len(parts) < 2 or parts[0].strip(b"\0"):
        raise SectionError("an H.264 access unit that does not begin with a start code")
    return [part.rstrip(b"\0") for part in parts[1:]]


def _types(units: list[bytes]) -> tuple[int, ...]:
    return tuple(unit[0] & 0x1F if unit else 0 for unit in units)


def without_remarks(data: bytes, *, idr: bool) -> bytes:
    """The access unit without what x264 says about itself, which takes 600 bytes; with start codes of three bytes.

    Raises SectionError if what is left is not an IDR picture, or not a P picture.
    """
    units = [unit for unit in split_units(data) if unit and unit[0] & 0x1F != REMARKS]
    if _types(units) != (_IDR_UNITS if idr else _P_UNITS):
        raise SectionError(f"NAL units of types {_types(units)}")
    return b"".join(_START + unit for unit in units)


class _Bits:
    """Reads numbers of a NAL unit, bit by bit."""

    def __init__(self, unit: bytes) -> None:
        plain = unit.replace(b"\0\0\3", b"\0\0")
        self._value, self._left = int.from_bytes(plain, "big"), 8 * len(plain)

    def number(self, bits: int) -> int:
        """An unsigned number of so many bits."""
        if self._left < bits:
            raise SectionError("H.264 sequence parameters that end too early")
        self._left -= bits
        return self._value >> self._left & (1 << bits) - 1

    def golomb(self) -> int:
        """An unsigned number of the form ue(v)."""
        zeros = 0
        while not self.number(1):
            zeros += 1
            if zeros > 31:
                raise SectionError("H.264 sequence parameters with a number that has no end")
        return (1 << zeros) - 1 + self.number(zeros)


def check_sequence(unit: bytes, rows: int, columns: int, bits: int) -> None:
    """Whether sequence parameters are those of pictures with one plane, of these sides, and `bits` bits a sample.

    Raises SectionError.
    """
    if len(unit) > _LONGEST_PARAMETERS:
        raise SectionError(f"H.264 sequence parameters of {len(unit)} bytes")
    read = _Bits(unit[1:])
    profile = read.number(8)
    read.number(16)
    number = read.golomb()
    if profile not in _HIGH_PROFILES or number > 31:
        raise SectionError(f"H.264 of profile {profile}, parameters {number}")
    kind = (read.golomb(), read.golomb() + 8, read.golomb() + 8, read.number(1), read.number(1))
    if kind[:2] != (0, bits) or kind[2] not in (8, bits) or kind[3:] != (0, 0):
        raise SectionError(f"H.264 pictures of chroma format {kind[0]}, {kind[1]} bits: 0, {bits} are expected")
    if read.golomb() > 12:
        raise SectionError("H.264 sequence parameters with frame numbers of more than 16 bits")
    order = read.golomb()
    if order == 0 and read.golomb() > 12:
        raise SectionError("H.264 sequence parameters with picture orders of more than 16 bits")
    references = read.golomb()
    if order not in (0, 2) or references > _MOST_REFERENCES:
        raise SectionError(f"H.264 of picture order {order}, {references} references")
    read.number(1)
    sides = (16 * (read.golomb() + 1), 16 * (read.golomb() + 1))
    whole_frames, _, cropped = read.number(1), read.number(1), read.number(1)
    if sides != (columns, rows) or not whole_frames or cropped:
        raise SectionError(f"H.264 pictures of {sides[0]} x {sides[1]} samples: {columns} x {rows} are expected")


def check_picture(data: bytes, rows: int, columns: int, bits: int, *, idr: bool) -> None:
    """Whether an access unit holds the NAL units of one IDR picture with these sides, or of one P picture.

    Raises SectionError.
    """
    units = split_units(data)
    if _types(units) != (_IDR_UNITS if idr else _P_UNITS):
        raise SectionError(f"an H.264 access unit with NAL units of types {_types(units)[:8]}")
    if idr:
        check_sequence(units[0], rows, columns, bits)
