"""Records of a pcapng file: sections of blocks, in either byte order, with interfaces of their own link type and clock.

    block     type u4, total length u4, body, total length u4 again; padded to four bytes
    0a0d0d0a  section: byte order; new list of interfaces     00000001  interface: link type, snap length, clock
    00000006  enhanced packet: interface, 64-bit time stamp   00000003  simple packet: neither     00000002  old packet

Format: draft-ietf-opsawg-pcapng, section 4. Blocks of other types are skipped. An invalid block ends the reading,
because the start of the next one is unknown.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Iterator
from typing import Final, NamedTuple

from lidarcodec.sources.captures.pcap import MAX_FRAME, Counted, Ending, Record
from lidarcodec.sources.decompress import ByteStream

MAGIC: Final = b"\x0a\x0d\x0d\x0a"
SECTION, INTERFACE, OLD_PACKET, SIMPLE_PACKET, ENHANCED_PACKET = 0x0A0D0D0A, 1, 2, 3, 6
MAX_BLOCK: Final = 1 << 24
MAX_INTERFACES: Final = 4096
OPTION_RESOLUTION, OPTION_OFFSET = 9, 14
STAMP_LIMIT_NS: Final = 1 << 62
"""The year 2116. Times after it or before 1970 are invalid."""


class _Interface(NamedTuple):
    linktype: int
    snap: int
    per_second: int
    offset_s: int


class _DamageError(Exception):
    """A block that contradicts itself."""


def read_pcapng(stream: ByteStream, data: bytes, ending: Ending, counts: Counter[str]) -> Iterator[Record]:
    """Records of a stream whose first bytes `data` were read already; they begin with MAGIC.

    Never raises for what it reads: `ending` says if the file was cut or damaged, `counts` what was skipped. A packet
    without a time stamp gets that of the packet before it. Cost: about 2 us a record.
    """
    order, start, number, stamp_ns = "<", 0, 0, 0
    interfaces: list[_Interface] = []
    too_many = Counted(stream, ending).too_many
    while True:
        end = start + 12
        if end <= len(data):
            if data[start : start + 4] == MAGIC:
                order = ">" if data[start + 8 : start + 12] == b"\x1a\x2b\x3c\x4d" else "<"
            kind, length = struct.unpack_from(order + "II", data, start)
            if length < 12 or length % 4 or length > MAX_BLOCK or len(interfaces) > MAX_INTERFACES:
                ending.set("damaged", f"block {number} claims {length} bytes behind {len(interfaces)} interfaces")
                return
            end = start + length
        if end > len(data):
            more = stream.read(end - len(data))
            if not more:
                if start < len(data):
                    ending.set("truncated", f"block {number} has {len(data) - start} of its bytes")
                return
            data, start = data[start:] + more, 0
            continue
        if struct.unpack_from(order + "I", data, end - 4)[0] != length:
            ending.set("damaged", f"block {number}: its two lengths differ")
            return
        try:
            if kind in (ENHANCED_PACKET, SIMPLE_PACKET, OLD_PACKET):
                record = _packet(kind, data[start + 8 : end - 4], order, interfaces, stamp_ns, counts)
                if record is not None:
                    stamp_ns = record.stamp_ns
                    yield record
            elif kind == SECTION:
                _check_section(data[start + 8 : end - 4], order)
                interfaces = []
            elif kind == INTERFACE:
                interfaces.append(_interface(data[start + 8 : end - 4], order))
        except _DamageError as damage:
            ending.set("damaged", f"block {number}: {damage}")
            return
        start = end
        number += 1
        if too_many(number):
            return


def _check_section(body: bytes, order: str) -> None:
    if len(body) < 16:
        raise _DamageError("a section header is too short")
    magic, major = struct.unpack_from(order + "IH", body)
    if magic != 0x1A2B3C4D:
        raise _DamageError("no byte order")
    if major != 1:
        raise _DamageError(f"pcapng version {major}, known is 1")


def _interface(body: bytes, order: str) -> _Interface:
    if len(body) < 8:
        raise _DamageError("an interface description is too short")
    linktype, _, snap = struct.unpack_from(order + "HHI", body)
    per_second, offset_s, position = 1_000_000, 0, 8
    while position + 4 <= len(body):
        code, length = struct.unpack_from(order + "HH", body, position)
        value = body[position + 4 : position + 4 + length]
        if code == 0 or len(value) < length:
            break
        if code == OPTION_RESOLUTION and length == 1:
            power = value[0] & 0x7F
            if power > 64:
                raise _DamageError(f"a clock of {'2' if value[0] & 0x80 else '10'}^{power} steps a second")
            per_second = 2**power if value[0] & 0x80 else 10**power
        elif code == OPTION_OFFSET and length == 8:
            offset_s = struct.unpack(order + "q", value)[0]
        position += 4 + length + -length % 4
    return _Interface(linktype, snap, per_second, offset_s)


def _packet(
    kind: int, body: bytes, order: str, interfaces: list[_Interface], last_ns: int, counts: Counter[str]
) -> Record | None:
    """The record of a packet block; None, and counted, if its interface was not described."""
    head = 4 if kind == SIMPLE_PACKET else 20
    if len(body) < head:
        raise _DamageError("a packet block is too short")
    if kind == ENHANCED_PACKET:
        index, high, low, captured = struct.unpack_from(order + "IIII", body)
    elif kind == OLD_PACKET:
        index, _, high, low, captured = struct.unpack_from(order + "HHIII", body)
    else:
        index, captured = 0, struct.unpack_from(order + "I", body)[0]
    if index >= len(interfaces):
        counts["packets of no interface"] += 1
        return None
    interface = interfaces[index]
    if kind == SIMPLE_PACKET:
        captured = min(captured, interface.snap or MAX_FRAME, len(body) - head)
        counts["without time stamp"] += 1
        stamp_ns = last_ns
    else:
        stamp_ns = ((high << 32) | low) * 1_000_000_000 // interface.per_second + interface.offset_s * 1_000_000_000
        if not 0 <= stamp_ns < STAMP_LIMIT_NS:
            counts["impossible time stamp"] += 1
            stamp_ns = last_ns
    if captured > min(len(body) - head, MAX_FRAME):
        raise _DamageError(f"a packet claims {captured} bytes of {len(body) - head}")
    return Record(stamp_ns, interface.linktype, body[head : head + captured])
