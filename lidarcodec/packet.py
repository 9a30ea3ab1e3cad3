"""Packet: a datagram of the sensor, and when this host received it.

A sensor sends two kinds: data packets with ranges (1206 bytes, port 2368), and position packets with what its GPS said
(512 bytes, port 8308; "position packet structure" in the VLP-16 and HDL-32E user manuals). Both travel in one order.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Final, NamedTuple

UNKEPT_POSITIONS: Final = "position packets not kept"
"""The count of position packets that are lost, of whatever cause."""


class Packet(NamedTuple):
    """One sensor packet.

    payload: bytes as they came, 1206 of a data packet; stamp_ns: host time of receipt, ns since the Unix epoch.
    position: whether this is a position packet.
    The device's own clock is inside the payload and is never mixed with the host's.
    """

    payload: bytes
    stamp_ns: int
    position: bool = False


class FirstPacket(Packet):
    """The first packet of another sender than the one before: no frame holds packets of both."""

    __slots__ = ()


def data_packets(packets: Iterable[Packet]) -> Iterator[Packet]:
    """The data packets of a run of packets, without its position packets."""
    return (packet for packet in packets if not packet.position)


def part_of(packets: Iterable[Packet], skip: int, count: int | None) -> Iterator[Packet]:
    """The data packets from number `skip` on, at most `count` of them, with the position packets between them.

    Position packets before the first of all, and after the last of all, are there too.
    """
    end = None if count is None else skip + count
    number = 0
    for packet in packets:
        if not packet.position:
            if number == end:
                return
            number += 1
        if number > skip or (skip == 0 and packet.position):
            yield packet
