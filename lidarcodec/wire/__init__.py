"""Messages to bytes and back, the same for every codec. The format is docs/wire-format.md.

>>> from lidarcodec.message import Message, Section, SectionType
>>> message = Message(codec=1, stream_id=7, frame_index=3, stamp_ns=5, key=True, width=6, packets=1,
...                   sections=(Section(SectionType.RANGE, b"abc"),))
>>> data = pack(message)
>>> len(data), unpack(data) == message, peek(data).frame_index
(69, True, 3)
"""

from __future__ import annotations

from lidarcodec.errors import HeaderError, TruncatedError
from lidarcodec.message import Message
from lidarcodec.wire.checksum import checked_body, checksum_of, with_checksum
from lidarcodec.wire.header import (
    CHECKSUM_BYTES,
    HEADER_BYTES,
    MAX_MESSAGE,
    Header,
    check_version,
    goes_on,
    header_bytes_of,
    read_header,
)
from lidarcodec.wire.sections import SECTION_HEAD, read_sections, section_bytes

__all__ = ["HEADER_BYTES", "MAX_MESSAGE", "Header", "checksum_of", "goes_on", "pack", "peek", "size_of", "unpack"]


def pack(message: Message) -> bytes:
    """Bytes of a message: header, sections, CRC-32C.

    Raises HeaderError or SectionError if a field does not fit the format.
    """
    sections = section_bytes(message.sections)
    head = header_bytes_of(message, HEADER_BYTES + len(sections) + CHECKSUM_BYTES)
    return with_checksum(head + sections)


def size_of(message: Message) -> int:
    """Number of bytes of a packed message, without packing it."""
    sections = sum(SECTION_HEAD.size + len(section.data) for section in message.sections)
    return HEADER_BYTES + sections + CHECKSUM_BYTES


def peek(data: bytes) -> Header:
    """Header of a message, from its first 56 bytes or more; for routers and recorders.

    Raises HeaderError, UnsupportedVersionError or TruncatedError. Checks the header's own limits, not the checksum.
    """
    return read_header(data)


def unpack(data: bytes) -> Message:
    """Message of exactly these bytes. Size and checksum are checked before any field is used.

    Raises HeaderError, UnsupportedVersionError, TruncatedError, ChecksumError or SectionError.
    """
    data = bytes(data)
    check_version(data)
    if len(data) < HEADER_BYTES + CHECKSUM_BYTES:
        raise TruncatedError(f"a message of {len(data)} bytes is shorter than the shortest possible", len(data))
    total = int.from_bytes(data[8:12], "little")
    if len(data) > MAX_MESSAGE or total < HEADER_BYTES + CHECKSUM_BYTES or len(data) > total:
        raise HeaderError(
            f"a message announces {total} bytes, but has {len(data)}; at most {MAX_MESSAGE} are allowed", 8
        )
    if len(data) < total:
        raise TruncatedError(f"a message of {total} bytes was cut off after {len(data)}", len(data))
    body = checked_body(data)
    header = read_header(data)
    return Message(
        codec=header.codec,
        stream_id=header.stream_id,
        frame_index=header.frame_index,
        stamp_ns=header.stamp_ns,
        key=header.key,
        width=header.width,
        packets=header.packets,
        sections=read_sections(body, header),
        frame_count=header.frame_count,
        needs=header.needs,
        planes=header.planes,
        goes_on=header.goes_on,
        more=header.more,
    )
