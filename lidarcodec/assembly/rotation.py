"""RotationWatch: sees in the packets of an HDL-64E when a new turn begins.

>>> watch = RotationWatch()
>>> [watch.begins(rotation.to_bytes(2, "little").rjust(4) + bytes(1202)) for rotation in (35800, 35900, 4, 104)]
[False, False, True, False]
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import accumulate
from typing import Final

from lidarcodec.packet import Packet
from lidarcodec.units import AZIMUTH_TURN, MAX_PACKETS

LAST_BLOCK: Final = 1100
"""Offset of the last of the twelve blocks of a packet."""


class RotationWatch:
    """Compares the rotation of each packet's first block with that of the packet before. A rotation of a whole turn or
    more is damaged, and says nothing. Without a wrap a turn ends after MAX_PACKETS: a sensor can stand still."""

    def __init__(self) -> None:
        self._last = -1
        self._packets = 0

    def begins(self, payload: bytes) -> bool:
        """Whether a new turn begins with this packet. payload: 1206 bytes

        If the rotation wraps within the first packet, the turn begins with that packet: it has nearly all of the turn
        to come, and no other packet would be in its frame.
        """
        begins = self._packets == MAX_PACKETS
        now = _rotation(payload, 0)
        if now < AZIMUTH_TURN:
            begins |= now < self._last - AZIMUTH_TURN // 2
            if self._last < 0 and (last := _rotation(payload, LAST_BLOCK)) < now - AZIMUTH_TURN // 2:
                now = last
            self._last = now
        self._packets = 1 if begins else self._packets + 1
        return begins


def part_ends(parts: int) -> list[int]:
    """Where the parts of a turn end, in 0.01 degree. Each is shorter than the one before: the last one is waited for.

    >>> part_ends(3)
    [18000, 30000, 36000]
    """
    shares = list(accumulate(range(parts, 0, -1)))
    return [AZIMUTH_TURN * share // shares[-1] for share in shares]


class PartWatch:
    """Sees in the packets of an HDL-64E when another part of a turn begins. parts: of a turn"""

    def __init__(self, parts: int) -> None:
        self._ends: Final = part_ends(parts)
        self._end = 0

    def begins(self, payload: bytes, *, turn: bool) -> bool:
        """Whether another part begins with this packet. payload: 1206 bytes; turn: whether a turn begins with it"""
        now = _rotation(payload, 0)
        if turn:
            if (last := _rotation(payload, LAST_BLOCK)) < now - AZIMUTH_TURN // 2:
                now = last
            self._end = next((end for end in self._ends if now < end), AZIMUTH_TURN)
            return False
        if not self._end <= now < AZIMUTH_TURN:
            return False
        self._end = next(end for end in self._ends if now < end)
        return True


def turns_of(packets: Iterable[Packet], turns: int) -> Iterator[Packet]:
    """Packets of the first `turns` turns of an HDL-64E. The first turn is short if the packets begin within it."""
    rotation, begun = RotationWatch(), 1
    for packet in packets:
        begun += not packet.position and rotation.begins(packet.payload)
        if begun > turns:
            return
        yield packet


def _rotation(payload: bytes, block: int) -> int:
    return payload[block + 2] | payload[block + 3] << 8
