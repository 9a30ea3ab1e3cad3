"""A message byte by byte, for `lidarcodec info FILE --message N`.

>>> from lidarcodec.message import Message, Section, SectionType
>>> from lidarcodec.wire import pack
>>> message = Message(codec=3, stream_id=7, frame_index=3, stamp_ns=5, key=True, width=6, packets=1,
...                   sections=(Section(SectionType.RANGE, b"abc"),))
>>> for part in explain(pack(message))[-3:]:
...     print(part.offset, part.size, part.name, "=", part.value)
56 6 section 0 head = range, frame 0 of the message, 3 bytes
62 3 section 0 data = 61 62 63
65 4 checksum = 40ad4047, as computed
"""

from __future__ import annotations

from datetime import UTC, datetime
from typing import NamedTuple

from lidarcodec.codecs import table
from lidarcodec.errors import ChecksumError, UnsupportedVersionError
from lidarcodec.message import SectionType
from lidarcodec.wire import peek
from lidarcodec.wire.checksum import checked_body
from lidarcodec.wire.header import CHECKSUM_BYTES, Header
from lidarcodec.wire.sections import SECTION_HEAD, read_sections

_SHOWN_BYTES = 16


class Part(NamedTuple):
    """A range of bytes and its meaning."""

    offset: int
    size: int
    name: str
    value: str


def section_name(kind: int) -> str:
    """Name of a section type; its number if it is unknown."""
    return SectionType(kind).name.lower() if kind in set(SectionType) else f"unknown type {kind}"


def codec_name(number: int) -> str:
    """Name of a codec; its number if this build does not have it."""
    try:
        return table.codec_name(number)
    except UnsupportedVersionError:
        return f"unknown codec {number}"


def time_text(stamp_ns: int) -> str:
    """A host time as UTC with nanoseconds."""
    seconds, ns = divmod(stamp_ns, 1_000_000_000)
    try:
        return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%d %H:%M:%S}.{ns:09d} UTC"
    except (OverflowError, ValueError, OSError):
        return f"{stamp_ns} ns"


def _header_parts(data: bytes, header: Header) -> list[Part]:
    flags = int.from_bytes(data[14:16], "little")
    meant = ["key" if header.key else "inter"] + ([] if header.needs is None else ["needs a frame"])
    return [
        Part(0, 4, "magic", data[:4].hex(" ")),
        Part(4, 1, "major version", str(header.major)),
        Part(5, 1, "minor version", str(header.minor)),
        Part(6, 2, "bytes of this header", str(header.header_bytes)),
        Part(8, 4, "bytes of the message", str(header.total_bytes)),
        Part(12, 2, "codec", f"{header.codec} ({codec_name(header.codec)})"),
        Part(14, 2, "flags", f"{flags:#06x} ({', '.join(meant)})"),
        Part(16, 8, "stream id", f"{header.stream_id:016x}"),
        Part(24, 8, "stamp", f"{header.stamp_ns} ({time_text(header.stamp_ns)})"),
        Part(32, 8, "frame index", str(header.frame_index)),
        Part(40, 8, "needs", "none" if header.needs is None else f"frame {header.needs}"),
        Part(48, 2, "frames", str(header.frame_count)),
        Part(50, 2, "width in columns", str(header.width)),
        Part(52, 2, "packets", str(header.packets)),
        Part(54, 2, "sections", str(header.section_count)),
    ]


def _preview(data: bytes) -> str:
    return data[:_SHOWN_BYTES].hex(" ") + (" ..." if len(data) > _SHOWN_BYTES else "")


def explain(data: bytes) -> list[Part]:
    """Every byte of a message, in order.

    Raises DecodeError if the header or a section is invalid. A wrong checksum is reported, but is no error.
    """
    header = peek(data)
    parts = _header_parts(data, header)
    fixed = parts[-1].offset + parts[-1].size
    if header.header_bytes > fixed:
        more = data[fixed : header.header_bytes]
        parts.append(Part(fixed, len(more), "fields of a newer minor version", _preview(more)))
    at = header.header_bytes
    for number, section in enumerate(read_sections(data[:-CHECKSUM_BYTES], header)):
        head = f"{section_name(section.type)}, frame {section.ordinal} of the message, {len(section.data)} bytes"
        parts.append(Part(at, SECTION_HEAD.size, f"section {number} head", head))
        at += SECTION_HEAD.size
        parts.append(Part(at, len(section.data), f"section {number} data", _preview(section.data)))
        at += len(section.data)
    try:
        checked_body(data)
        verdict = "as computed"
    except ChecksumError as error:
        verdict = f"WRONG: {error}"
    stored = int.from_bytes(data[-CHECKSUM_BYTES:], "little")
    parts.append(Part(at, CHECKSUM_BYTES, "checksum", f"{stored:08x}, {verdict}"))
    return parts
