"""Compares the position packets of a recording with its source: same bytes, same places, times within a microsecond.

A position packet between two frames may belong to either of them. So the position packets after the last data packet of
one frame and before the first data packet of the next are compared together. At a gap, and at both ends of the
recording, a missing frame may have some of them. There the recording's packets must be in the source, but the source
may have more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

from lidarcodec.packet import Packet

ROUNDED_NS: Final = 1000
"""Host times are sent in whole microseconds."""


def places(packets: Sequence[Packet]) -> tuple[list[Packet], list[list[Packet]]]:
    """Data packets, and lists of the position packets before each of them. The last list has those after the last
    one.
    """
    data: list[Packet] = []
    before: list[list[Packet]] = [[]]
    for packet in packets:
        if packet.position:
            before[-1].append(packet)
        else:
            data.append(packet)
            before.append([])
    return data, before


@dataclass
class PositionComparison:
    """Counts position packets frame by frame. recorded: in the recording; identical: equal to the source's at the same
    place; missing: in a recorded part of the source, but not in the recording"""

    recorded: int = 0
    identical: int = 0
    missing: int = 0
    _tail: list[Packet] | None = field(default=None, repr=False)

    @property
    def all_identical(self) -> bool:
        """Whether every recorded position packet is identical and none is missing."""
        return self.identical == self.recorded and not self.missing

    def add(self, ours: list[list[Packet]], theirs: list[list[Packet]], passed: list[Packet] | None) -> None:
        """Compare a frame of P data packets.

        ours: position packets before each of them, and after the last; theirs: before each of them in the source
        passed: position packets after the previous frame in the source; None if this frame follows it without a gap
        """
        if len(ours) == 1:
            self._tail = (self._tail or []) + ours[0]
            return
        follows = passed is None
        if passed is not None:
            self._open_end(passed)
        tail, self._tail = self._tail or [], ours[-1]
        if follows:
            self._same(tail + ours[0], theirs[0])
        else:
            self._within(ours[0], theirs[0][len(theirs[0]) - len(ours[0]) :] if ours[0] else [])
        for mine, wanted in zip(ours[1:-1], theirs[1:], strict=True):
            self._same(mine, wanted)

    def lost(self, ours: list[list[Packet]]) -> None:
        """Count the position packets of a frame that is not in the source."""
        self.recorded += sum(map(len, ours))

    def finish(self, behind: list[Packet], *, last: bool) -> None:
        """Compare the position packets after the last frame. behind: those in the source; last: whether no data packet
        follows in the source"""
        if last:
            self._same(self._tail or [], behind)
            self._tail = None
        else:
            self._open_end(behind)

    def _open_end(self, behind: list[Packet]) -> None:
        tail, self._tail = self._tail or [], None
        self._within(tail, behind[: len(tail)])

    def _same(self, ours: list[Packet], theirs: list[Packet]) -> None:
        self._within(ours, theirs)
        self.missing += max(0, len(theirs) - len(ours))

    def _within(self, ours: list[Packet], theirs: list[Packet]) -> None:
        self.recorded += len(ours)
        self.identical += sum(
            one.payload == other.payload and abs(one.stamp_ns - other.stamp_ns) <= ROUNDED_NS
            for one, other in zip(ours, theirs, strict=False)
        )
