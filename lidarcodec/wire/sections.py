"""Sections: 6 bytes each (type u8, ordinal u8, length u32) in front of their data, one after the other."""

from __future__ import annotations

import struct
from typing import Final

from lidarcodec.errors import SectionError, TruncatedError
from lidarcodec.message import Section, SectionType
from lidarcodec.wire.header import MAX_MESSAGE, Header

SECTION_HEAD: Final = struct.Struct("<BBI")
_OF_A_FRAME: Final = frozenset(int(kind) for kind in SectionType) - {int(SectionType.MOUNT)}
"""Types whose ordinal names a frame of the message. A mounting is of all of them."""


def section_bytes(sections: tuple[Section, ...]) -> bytes:
    """Bytes of the sections in their order.

    Raises SectionError if a type, ordinal or length does not fit its field.
    """
    parts: list[bytes] = []
    for kind, data, ordinal in sections:
        if not (0 <= kind <= 0xFF and 0 <= ordinal <= 0xFF and len(data) <= MAX_MESSAGE):
            raise SectionError(f"section of type {kind}, ordinal {ordinal}, {len(data)} bytes does not fit a message")
        parts += (SECTION_HEAD.pack(kind, ordinal, len(data)), data)
    return b"".join(parts)


def read_sections(body: bytes, header: Header) -> tuple[Section, ...]:
    """Sections of a message. Sections of unknown types are kept, so that a relay can forward them.

    body: the message without its checksum
    Raises TruncatedError if a section is longer than the rest of the message, SectionError if bytes are left over or a
    known section belongs to no frame of the message.
    """
    at, end = header.header_bytes, len(body)
    found: list[Section] = []
    for number in range(header.section_count):
        if end - at < SECTION_HEAD.size:
            raise TruncatedError(f"section {number} of {header.section_count} begins beyond the end of the message", at)
        kind, ordinal, length = SECTION_HEAD.unpack_from(body, at)
        if kind in _OF_A_FRAME and ordinal >= header.frame_count:
            raise SectionError(f"section {number} belongs to frame {ordinal} of {header.frame_count}", at + 1)
        at += SECTION_HEAD.size
        if end - at < length:
            raise TruncatedError(f"section {number} announces {length} bytes, {end - at} are left", at - 4)
        found.append(Section(kind, body[at : at + length], ordinal))
        at += length
    if at != end:
        raise SectionError(f"{end - at} bytes after the last section", at)
    return tuple(found)
