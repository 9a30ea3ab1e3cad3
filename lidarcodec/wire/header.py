"""The fixed part of a message: 56 bytes, little endian (docs/wire-format.md, "Header").

     0  4  magic 93 4C 44 43       16  8  stream id            48  2  frames (1..64)
     4  1  major version           24  8  stamp, ns, signed    50  2  width in columns
     5  1  minor version           32  8  frame index          52  2  packets
     6  2  bytes of this header    40  8  needs                54  2  sections
     8  4  bytes of the message    12  2  codec                14  2  flags

A newer minor version may append header fields, give meaning to flags 0-7 and add section types: older readers skip
all three. Everything else needs a newer major version, or one of the flags 8-15, and is refused by older readers.
"""

from __future__ import annotations

import struct
from typing import Final, NamedTuple

from lidarcodec.errors import HeaderError, TruncatedError, UnsupportedVersionError
from lidarcodec.message import Message
from lidarcodec.units import MAX_COLUMNS, MAX_PACKETS

MAGIC: Final = b"\x93LDC"
MAJOR: Final = 1
MINOR: Final = 0
MAX_MESSAGE: Final = 64 * 2**20
MAX_FRAMES: Final = 64
MAX_SECTIONS: Final = 256
CHECKSUM_BYTES: Final = 4

FLAG_KEY: Final = 1
FLAG_NEEDS: Final = 2
FLAG_MORE: Final = 4
FLAG_PLANES: Final = 0x100
FLAG_GOES_ON: Final = 0x200
_KNOWN_CRITICAL: Final = FLAG_PLANES | FLAG_GOES_ON
CRITICAL_FLAGS: Final = 0xFF00
"""Flags that change the meaning of a message: a reader that does not know one refuses the message."""

LAYOUT: Final = struct.Struct("<4sBBHIHHQqQQHHHH")
HEADER_BYTES: Final = LAYOUT.size
_VERSION_BYTES: Final = 5
_FLAGS_AT: Final = 14


class Header(NamedTuple):
    """Header of a message; fields as in `Message`.

    major, minor: format version; header_bytes, total_bytes: sizes; section_count: sections that follow.
    """

    major: int
    minor: int
    header_bytes: int
    total_bytes: int
    codec: int
    key: bool
    stream_id: int
    stamp_ns: int
    frame_index: int
    needs: int | None
    frame_count: int
    width: int
    packets: int
    section_count: int
    planes: bool = False
    goes_on: bool = False
    more: bool = False


def _check(value: int, low: int, high: int, what: str, offset: int) -> None:
    if not low <= value <= high:
        raise HeaderError(f"message header: {what} is {value}, allowed is {low} to {high}", offset)


def _check_fields(header: Header) -> None:
    _check(header.total_bytes, HEADER_BYTES + CHECKSUM_BYTES, MAX_MESSAGE, "message size", 8)
    _check(header.header_bytes, HEADER_BYTES, header.total_bytes - CHECKSUM_BYTES, "header size", 6)
    _check(header.codec, 0, 0xFFFF, "codec", 12)
    _check(header.stream_id, 0, 2**64 - 1, "stream id", 16)
    _check(header.stamp_ns, -(2**63), 2**63 - 1, "stamp", 24)
    _check(header.frame_index, 0, 2**63 - 1, "frame index", 32)
    _check(header.frame_count, 1, MAX_FRAMES, "frame count", 48)
    _check(header.width, 0, MAX_COLUMNS, "width", 50)
    _check(header.packets, 0, MAX_PACKETS, "packet count", 52)
    _check(header.section_count, 0, MAX_SECTIONS, "section count", 54)
    if header.needs is not None:
        if header.key:
            raise HeaderError(f"message header: a key message that needs frame {header.needs}", 14)
        _check(header.needs, 0, header.frame_index - 1, "needed frame", 40)
    if header.goes_on and (header.planes or header.frame_count != 1 or header.needs != header.frame_index - 1):
        raise HeaderError("message header: a part of a turn that does not go on from the frame before", 14)


def header_bytes_of(message: Message, total_bytes: int) -> bytes:
    """The 56 header bytes of a message of `total_bytes`.

    Raises HeaderError if a field is out of its limits.
    """
    needs = message.needs
    header = Header(
        MAJOR, MINOR, HEADER_BYTES, total_bytes, message.codec, message.key, message.stream_id, message.stamp_ns,
        message.frame_index, needs, message.frame_count, message.width, message.packets, len(message.sections),
        message.planes, message.goes_on, message.more,
    )  # fmt: skip
    _check_fields(header)
    flags = (FLAG_KEY if message.key else 0) | (FLAG_NEEDS if needs is not None else 0)
    flags |= FLAG_PLANES if message.planes else 0
    flags |= (FLAG_GOES_ON if message.goes_on else 0) | (FLAG_MORE if message.more else 0)
    return LAYOUT.pack(
        MAGIC, MAJOR, MINOR, HEADER_BYTES, total_bytes, header.codec, flags, header.stream_id, header.stamp_ns,
        header.frame_index, needs or 0, header.frame_count, header.width, header.packets, header.section_count,
    )  # fmt: skip


def goes_on(data: bytes) -> bool:
    """Whether the bytes are, by the flags in their header, a message that goes on from the part of a turn before."""
    return len(data) >= HEADER_BYTES and bool(int.from_bytes(data[_FLAGS_AT : _FLAGS_AT + 2], "little") & FLAG_GOES_ON)


def check_version(data: bytes, *, magic: bytes = MAGIC, major: int = MAJOR, what: str = "message") -> None:
    """Check magic and major version, which have the same place in every version, of messages and of refinements.

    Raises HeaderError if the bytes are not a message, UnsupportedVersionError for another major version, and
    TruncatedError.
    """
    if data[:4] != magic[: len(data)]:
        raise HeaderError(f"not a {what}: it begins with {data[:4].hex(' ')}, not {magic.hex(' ')}")
    if len(data) < _VERSION_BYTES:
        raise TruncatedError(f"a {what} of {len(data)} bytes ends within its version", len(data))
    if data[4] != major:
        raise UnsupportedVersionError(
            f"{what} of format version {data[4]}: this build reads version {major}; update the older side", 4
        )


def read_header(data: bytes) -> Header:
    """Header of a message of which at least the first 56 bytes are given.

    Raises HeaderError, UnsupportedVersionError or TruncatedError. Does not look at checksum or sections.
    """
    check_version(data)
    if len(data) < HEADER_BYTES:
        raise TruncatedError(f"a message of {len(data)} bytes ends within its {HEADER_BYTES}-byte header", len(data))
    (_, major, minor, size, total, codec, flags, stream, stamp, index, needs, frames, width, packets, sections) = (
        LAYOUT.unpack_from(data)
    )
    if flags & CRITICAL_FLAGS & ~_KNOWN_CRITICAL:
        raise UnsupportedVersionError(f"message with flags {flags:#06x}: this build does not know all of them", 14)
    if needs and not flags & FLAG_NEEDS:
        raise HeaderError(f"message header: names frame {needs} without the flag that it needs one", 40)
    header = Header(
        major, minor, size, total, codec, bool(flags & FLAG_KEY), stream, stamp, index,
        needs if flags & FLAG_NEEDS else None, frames, width, packets, sections, bool(flags & FLAG_PLANES),
        bool(flags & FLAG_GOES_ON), bool(flags & FLAG_MORE),
    )  # fmt: skip
    _check_fields(header)
    return header
