"""Captured frames -> UDP datagrams: link layer, VLAN tags, IPv4 and IPv6, fragments.

    linktype 1 Ethernet   113, 276 Linux "any" device   0, 108 loopback   101, 228, 229 (and 12, 14) plain IP

A frame that is not a complete UDP datagram is skipped and counted by cause. Every length is checked before it is used.
"""

from __future__ import annotations

import struct
from collections import Counter
from typing import Final, NamedTuple

from lidarcodec.sources.captures.fragments import Reassembler

IPV4, IPV6 = 0x0800, 0x86DD
VLAN_TAGS: Final = frozenset({0x8100, 0x88A8, 0x9100})
MAX_TAGS: Final = 8
UDP: Final = 17
FRAGMENT: Final = 44
EXTENSIONS: Final = frozenset({0, 43, 60})
"""IPv6 extension headers that are skipped: hop by hop, routing, destination options."""
MAX_EXTENSIONS: Final = 8

_FAST = struct.Struct(">12xHBxH2xHxB2x4s4sHHH2x")  # Ethernet, IPv4 without options, UDP: 42 bytes


class Datagram(NamedTuple):
    """One UDP datagram: addresses as 4 or 16 bytes, destination port, payload."""

    source: bytes
    target: bytes
    port: int
    payload: bytes


class DatagramReader:
    """Frames in, datagrams out; holds the fragments of datagrams that are not complete yet."""

    def __init__(self, counts: Counter[str]) -> None:
        self._counts = counts
        self._fragments = Reassembler(counts)

    def read(self, linktype: int, frame: bytes) -> Datagram | None:
        """The datagram in this frame, or the one that its fragment completes. Cost: 0.6 us for an Ethernet frame."""
        if linktype == 1 and len(frame) >= 42:
            ethertype, first, total, flags, protocol, source, target, _, port, length = _FAST.unpack_from(frame)
            if (
                ethertype == IPV4
                and first == 0x45
                and protocol == UDP
                and not flags & 0x3FFF
                and total == length + 20
                and 8 <= length <= len(frame) - 34
            ):
                return Datagram(source, target, port, frame[42 : 34 + length])
        return self._read_any(linktype, frame)

    def finish(self) -> None:
        """Count datagrams that never became complete."""
        self._fragments.finish()

    def _read_any(self, linktype: int, frame: bytes) -> Datagram | None:
        start = _network_layer(linktype, frame)
        if start is None:
            self._counts["unknown link type" if linktype not in _LINKS else "other traffic"] += 1
            return None
        version = frame[start] >> 4 if start < len(frame) else 0
        if version == 4:
            return self._ipv4(frame[start:])
        if version == 6:
            return self._ipv6(frame[start:])
        self._counts["other traffic"] += 1
        return None

    def _ipv4(self, packet: bytes) -> Datagram | None:
        if len(packet) < 20:
            return self._skip("cut packets")
        total, identity, flags, protocol = struct.unpack_from(">2xHHHxB", packet)
        head = (packet[0] & 15) * 4
        total = total or len(packet)  # segmentation offload leaves 0
        if protocol != UDP:
            return self._skip("other traffic")
        if head < 20 or total < head:
            return self._skip("bad packets")
        if total > len(packet):
            if flags & 0x3FFF or not _whole_udp(packet[head:]):
                return self._skip("cut packets")
            total = len(packet)  # a VLP-16 writes the size of its data packets into the header of its position packets
        source, target, body = packet[12:16], packet[16:20], packet[head:total]
        if flags & 0x3FFF:
            offset, more = (flags & 0x1FFF) * 8, bool(flags & 0x2000)
            whole = self._fragments.add((source, target, identity), offset, more, body)
            return None if whole is None else self._udp(source, target, whole)
        return self._udp(source, target, body)

    def _ipv6(self, packet: bytes) -> Datagram | None:
        if len(packet) < 40:
            return self._skip("cut packets")
        length, following = struct.unpack_from(">4xHB", packet)
        if 40 + length > len(packet):
            return self._skip("cut packets")
        source, target = packet[8:24], packet[24:40]
        body = packet[40 : 40 + length] if length else packet[40:]
        for _ in range(MAX_EXTENSIONS):
            if following == UDP:
                return self._udp(source, target, body)
            if following == FRAGMENT and len(body) >= 8:
                if body[0] != UDP:  # headers between IP and UDP; sensors send none
                    return self._skip("other traffic")
                place, identity = struct.unpack_from(">HI", body, 2)
                whole = self._fragments.add((source, target, identity), place & 0xFFF8, bool(place & 1), body[8:])
                return None if whole is None else self._udp(source, target, whole)
            if following not in EXTENSIONS or len(body) < 8:
                break
            following, body = body[0], body[(body[1] + 1) * 8 :]
        return self._skip("other traffic")

    def _udp(self, source: bytes, target: bytes, body: bytes) -> Datagram | None:
        if len(body) < 8:
            return self._skip("bad packets")
        port, length = struct.unpack_from(">2xHH", body)
        length = length or len(body)
        if not 8 <= length <= len(body):
            return self._skip("bad packets")
        return Datagram(source, target, port, body[8:length])

    def _skip(self, cause: str) -> Datagram | None:
        self._counts[cause] += 1
        return None


def _whole_udp(body: bytes) -> bool:
    """Whether the datagram is as long as its own header says, whatever the header before it says."""
    return len(body) >= 8 and 8 <= int.from_bytes(body[4:6], "big") <= len(body)


_LINKS: Final = {
    1: (14, 12),
    113: (16, 14),
    276: (20, 0),
    0: (4, None),
    108: (4, None),
    **dict.fromkeys((12, 14, 101, 228, 229), (0, None)),
}
"""Link type -> bytes of its header, and the offset of the EtherType in it."""


def _network_layer(linktype: int, frame: bytes) -> int | None:
    """Offset of the IP packet in a frame; None if there is none."""
    if linktype not in _LINKS:
        return None
    start, where = _LINKS[linktype]
    if len(frame) < start:
        return None
    if where is None:
        return start
    ethertype = int.from_bytes(frame[where : where + 2], "big")
    for _ in range(MAX_TAGS):
        if ethertype not in VLAN_TAGS:
            break
        ethertype = int.from_bytes(frame[start + 2 : start + 4], "big")
        start += 4
    return start if ethertype in (IPV4, IPV6) else None
