"""Captures made by hand, byte by byte from the format specifications: what the readers are tested against."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence

SENSOR, OTHER, BROADCAST = bytes((192, 168, 3, 43)), bytes((192, 168, 3, 44)), bytes((192, 168, 3, 255))
SENSOR6, TARGET6 = bytes.fromhex("fe80" + "00" * 13 + "2b"), bytes.fromhex("ff02" + "00" * 13 + "01")
T0_NS = 1_700_000_000_123_456_789


def payload(number: int) -> bytes:
    """A packet that only an HDL-64E can have sent (alternating blocks), told apart by its number."""
    blocks = []
    for block in range(12):
        flag = 0xEEFF if block % 2 == 0 else 0xDDFF
        azimuth = (number * 108 + block // 2 * 18) % 36000
        blocks.append(struct.pack("<HH", flag, azimuth) + struct.pack("<HB", 1000 + number % 5000, number % 256) * 32)
    return b"".join(blocks) + struct.pack("<IBB", number * 288 % 3_600_000_000, 0, 0)


def udp(data: bytes, source: bytes = SENSOR, port: int = 2368, length: int | None = None) -> bytes:
    """UDP header and data."""
    return struct.pack(">HHHH", 443, port, 8 + len(data) if length is None else length, 0) + data


def ipv4(
    body: bytes, source: bytes = SENSOR, *, options: bytes = b"", identity: int = 7, flags: int = 0, protocol: int = 17
) -> bytes:
    """IPv4 header, with options, and body."""
    head = 20 + len(options)
    return (
        struct.pack(">BBHHHBBH", 0x40 | head // 4, 0, head + len(body), identity, flags, 64, protocol, 0)
        + source
        + BROADCAST
        + options
        + body
    )


def ipv6(body: bytes, following: int = 17) -> bytes:
    """IPv6 header and body."""
    return struct.pack(">IHBB", 0x60000000, len(body), following, 64) + SENSOR6 + TARGET6 + body


def ethernet(packet: bytes, tags: Sequence[int] = (), ethertype: int = 0x0800) -> bytes:
    """Ethernet header with VLAN tags of these types, and the packet."""
    head = b"\xff" * 6 + b"\x02\0\0\0\0\1"
    for tag in tags:
        head += struct.pack(">HH", tag, 100)
    return head + struct.pack(">H", ethertype) + packet


def frame(data: bytes, source: bytes = SENSOR, port: int = 2368) -> bytes:
    """The usual frame: Ethernet, IPv4, UDP."""
    return ethernet(ipv4(udp(data, port=port), source))


def pcap(
    frames: Iterable[bytes], *, linktype: int = 1, order: str = "<", nanoseconds: bool = False, step_ns: int = 288_000
) -> bytes:
    """A classic pcap file; frame k is stamped T0_NS + k * step_ns."""
    out = [struct.pack(order + "IHHiIII", 0xA1B23C4D if nanoseconds else 0xA1B2C3D4, 2, 4, 0, 0, 65535, linktype)]
    for number, data in enumerate(frames):
        seconds, ns = divmod(T0_NS + number * step_ns, 10**9)
        fraction = ns if nanoseconds else ns // 1000
        out.append(struct.pack(order + "IIII", seconds, fraction, len(data), len(data)) + data)
    return b"".join(out)


def block(kind: int, body: bytes, order: str = "<") -> bytes:
    """One pcapng block."""
    body += bytes(-len(body) % 4)
    length = struct.pack(order + "I", 12 + len(body))
    return struct.pack(order + "I", kind) + length + body + length


def section(order: str = "<") -> bytes:
    """A pcapng section header."""
    return block(0x0A0D0D0A, struct.pack(order + "IHHq", 0x1A2B3C4D, 1, 0, -1), order)


def interface(linktype: int = 1, order: str = "<", resolution: int | None = None, offset_s: int | None = None) -> bytes:
    """A pcapng interface description with if_tsresol and if_tsoffset."""
    options = b""
    if resolution is not None:
        options += struct.pack(order + "HHB3x", 9, 1, resolution)
    if offset_s is not None:
        options += struct.pack(order + "HHq", 14, 8, offset_s)
    return block(1, struct.pack(order + "HHI", linktype, 0, 0) + options + bytes(4 if options else 0), order)


def enhanced(data: bytes, stamp: int, order: str = "<", index: int = 0) -> bytes:
    """A pcapng enhanced packet; `stamp` in the interface's own steps."""
    head = struct.pack(order + "IIIII", index, stamp >> 32, stamp & 0xFFFFFFFF, len(data), len(data))
    return block(6, head + data + bytes(-len(data) % 4), order)


def pcapng(frames: Iterable[bytes], *, order: str = "<", step_ns: int = 288_000) -> bytes:
    """A pcapng file with microseconds; frame k is stamped T0_NS + k * step_ns."""
    packets = [enhanced(data, (T0_NS + k * step_ns) // 1000, order) for k, data in enumerate(frames)]
    return section(order) + interface(order=order) + b"".join(packets)
