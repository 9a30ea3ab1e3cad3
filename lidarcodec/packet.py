"""Packet: a datagram of the sensor, and when this host received it.

A sensor sends two kinds: data packets with ranges (1206 bytes, port 2368), and position packets with its GPS data
(512 bytes, port 8308; "position packet structure" in the VLP-16 and HDL-32E user manuals). Their order is kept.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Final, NamedTuple

UNKEPT_POSITIONS: Final = "position packets not kept"
"""Name of the counter of position packets that are lost, for any reason."""


class Packet(NamedTuple):
    """One sensor packet.

    payload: bytes as received, 1206 of a data packet; stamp_ns: host time of receipt, ns since the Unix epoch.
    position: whether this is a position packet.
    The sensor's own clock is inside the payload and is never mixed with the host's.
    """

    payload: bytes
    stamp_ns: int
    position: bool = False


class FirstPacket(Packet):
    """The first packet after the sender changed. It begins a new frame: no frame mixes packets of two senders."""

    __slots__ = ()


class LastPacket(Packet):
    """The last packet of a turn, where that is known before the next packet: its frame need not wait for that one."""

    __slots__ = ()


def data_packets(packets: Iterable[Packet]) -> Iterator[Packet]:
    """The packets without position packets."""
    return (packet for packet in packets if not packet.position)


def part_of(packets: Iterable[Packet], skip: int, count: int | None) -> Iterator[Packet]:
    """At most `count` data packets from number `skip` on, with the position packets between them.

    Position packets at the very start and the very end of `packets` are included where the part reaches them.
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
