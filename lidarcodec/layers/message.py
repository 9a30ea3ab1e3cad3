"""Refinement: the message of one sector, and its bytes (docs/wire-format-layers.md).

     0  4  magic 93 4C 44 52      16  8  stream id             44  2  columns in a turn
     4  1  major version          24  8  stamp, ns, signed     46  2  columns of the sector
     5  1  minor version          32  8  frame index           48  4  bytes of the range part
     6  1  sector                 40  2  step of the base      52     range part, intensity part, CRC-32C
     7  1  parts                  42  2  step that is reached
     8  4  bytes of the message   12  4  checksum of the base

>>> one = Refinement(7, 3, 5, 11, 0xCAFE, 51, 1, 2000, 174, b"abc", b"de")
>>> unpack(pack(one)) == one
True
"""

from __future__ import annotations

import struct
from typing import Final, NamedTuple

from lidarcodec.errors import HeaderError, TruncatedError, UnsupportedVersionError
from lidarcodec.layers.sectors import SECTORS
from lidarcodec.settings import MAX_BOUND_M, step_of
from lidarcodec.units import MAX_COLUMNS
from lidarcodec.wire.checksum import checked_body, with_checksum
from lidarcodec.wire.header import CHECKSUM_BYTES, MAX_MESSAGE, check_version

MAGIC: Final = b"\x93LDR"
MAJOR: Final = 1
MINOR: Final = 0
HEAD: Final = struct.Struct("<4sBBBBIIQqQHHHHI")
PART_RANGE: Final = 1
PART_INTENSITY: Final = 2
MAX_STEP: Final = step_of(MAX_BOUND_M)


class Refinement(NamedTuple):
    """A sector's message.

    stream_id, frame_index, stamp_ns: of the base; base: checksum of what the base decodes to (`checksum_of_base`)
    base_step, step: quantiser widths in range steps, of the base and of what is reached; 1 is lossless
    turn: columns in a full turn, 0 if rows are not shifted; columns: of the sector
    ranges: coded ranges, None if there are none; intensity: an INTENSITY section of the sector's columns, or None
    """

    stream_id: int
    frame_index: int
    stamp_ns: int
    sector: int
    base: int
    base_step: int
    step: int
    turn: int
    columns: int
    ranges: bytes | None
    intensity: bytes | None


def is_refinement(data: bytes) -> bool:
    """Whether bytes begin as refinements do."""
    return data[: len(MAGIC)] == MAGIC


def pack(one: Refinement) -> bytes:
    """Bytes of a message."""
    ranges, intensity = one.ranges or b"", one.intensity or b""
    parts = (one.ranges is not None) * PART_RANGE | (one.intensity is not None) * PART_INTENSITY
    total = HEAD.size + len(ranges) + len(intensity) + CHECKSUM_BYTES
    head = HEAD.pack(
        MAGIC, MAJOR, MINOR, one.sector, parts, total, one.base, one.stream_id, one.stamp_ns, one.frame_index,
        one.base_step, one.step, one.turn, one.columns, len(ranges),
    )  # fmt: skip
    return with_checksum(head + ranges + intensity)


def peek_refinement(data: bytes) -> Refinement:
    """The head of a message, with empty parts, from its first 52 bytes or more; for routers and recorders.

    Raises HeaderError, UnsupportedVersionError or TruncatedError. Checks the limits of the fields, not the checksum.
    """
    check_version(data, magic=MAGIC, major=MAJOR, what="refinement")
    if len(data) < HEAD.size:
        raise TruncatedError(f"a refinement of {len(data)} bytes ends within its {HEAD.size}-byte header", len(data))
    (_, _, _, sector, parts, total, base, stream, stamp, index, base_step, step, turn, columns, ranges) = (
        HEAD.unpack_from(data)
    )
    if parts & ~(PART_RANGE | PART_INTENSITY):
        raise UnsupportedVersionError(f"refinement with parts {parts:#04x}: this build does not know all of them", 7)
    if not parts:
        raise HeaderError("a refinement without ranges and intensities refines nothing", 7)
    _check(total, HEAD.size + CHECKSUM_BYTES, MAX_MESSAGE, "size", 8)
    _check(ranges, 0, (total - HEAD.size - CHECKSUM_BYTES) * (parts & PART_RANGE), "size of the ranges", 48)
    if not parts & PART_INTENSITY:
        _check(total, 0, HEAD.size + ranges + CHECKSUM_BYTES, "size without intensities", 8)
    _check(sector, 0, SECTORS - 1, "sector", 6)
    _check(index, 0, 2**63 - 1, "frame index", 32)
    _check(columns, 1, MAX_COLUMNS, "number of columns", 46)
    for value, name, at in ((base_step, "step of the base", 40), (step, "step", 42)):
        _check(value, 1, MAX_STEP, name, at)
        if value % 2 == 0:
            raise HeaderError(f"refinement header: {name} is {value}, and is always odd", at)
    lowest, highest = (1, base_step - 1) if parts & PART_RANGE else (base_step, base_step)
    _check(step, lowest, highest, "step", 42)
    given = (b"" if parts & bit else None for bit in (PART_RANGE, PART_INTENSITY))
    return Refinement(stream, index, stamp, sector, base, base_step, step, turn, columns, *given)


def announced_size(data: bytes) -> int:
    """The size that a message announces. data: its first 12 bytes or more, already looked at by `peek_refinement`"""
    return int.from_bytes(data[8:12], "little")


def unpack(data: bytes) -> Refinement:
    """Message of exactly these bytes. Size and checksum are checked before any part is used.

    Raises HeaderError, UnsupportedVersionError, TruncatedError or ChecksumError.
    """
    data = bytes(data)
    head = peek_refinement(data)
    total = announced_size(data)
    if len(data) > total:
        raise HeaderError(f"a refinement announces {total} bytes, but has {len(data)}", 8)
    if len(data) < total:
        raise TruncatedError(f"a refinement of {total} bytes was cut off after {len(data)}", len(data))
    body = checked_body(data)
    middle = HEAD.size + int.from_bytes(body[48:52], "little")
    ranges = None if head.ranges is None else body[HEAD.size : middle]
    return head._replace(ranges=ranges, intensity=None if head.intensity is None else body[middle:])


def _check(value: int, low: int, high: int, what: str, offset: int) -> None:
    if not low <= value <= high:
        raise HeaderError(f"refinement header: {what} is {value}, allowed is {low} to {high}", offset)
