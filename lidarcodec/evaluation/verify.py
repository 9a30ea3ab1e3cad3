"""A recording against the source it was made from: are the packets the same, and how far off is any range?"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

from lidarcodec.assembly import packets_of
from lidarcodec.errors import SourceError
from lidarcodec.evaluation.metrics import RangeErrors
from lidarcodec.frame import Frame
from lidarcodec.packet import Packet
from lidarcodec.pipeline import frames_of
from lidarcodec.units import MAX_PACKETS

LATE_NS = 1_000_000_000
"""A packet this much younger than the one that is looked for: that one is not in the source."""


class PacketsByTime:
    """Finds the packets of a recording's frames again in the source, going forward only.

    Frames may be missing in the recording (replaced on the way, or left out by --skip): packets in between are passed
    over and counted in `passed`.
    """

    def __init__(self, packets: Iterable[Packet]) -> None:
        self._packets: Iterator[Packet] = iter(packets)
        self._waiting: deque[Packet] = deque()
        self.passed = 0

    def _look(self, at: int) -> Packet | None:
        while len(self._waiting) <= at:
            packet = next(self._packets, None)
            if packet is None:
                return None
            self._waiting.append(packet)
        return self._waiting[at]

    def take(self, first: Packet, count: int) -> list[Packet] | None:
        """`count` packets, beginning with the one that has the time of `first`; None if the source has none.

        Where several packets have that time (clocks of some recorders are coarse), the one with its bytes is meant.
        """
        at, found = 0, -1
        while (packet := self._look(at)) is not None and packet.stamp_ns <= first.stamp_ns + LATE_NS:
            if packet.stamp_ns == first.stamp_ns:
                found = at if found < 0 else found
                if packet.payload == first.payload:
                    found = at
                    break
            elif found >= 0:
                break
            at += 1
        if found < 0 or self._look(found + count - 1) is None:
            return None
        for _ in range(found):
            self._waiting.popleft()
        self.passed += found
        return [self._waiting.popleft() for _ in range(count)]


@dataclass
class Comparison:
    """What differs between a recording and its source, added up frame by frame."""

    frames: int = 0
    packets: int = 0
    identical_packets: int = 0
    not_in_source: int = 0
    errors: RangeErrors = field(default_factory=RangeErrors)

    @property
    def packets_identical(self) -> bool:
        """Whether every packet of the recording is, byte for byte, the source's."""
        return self.identical_packets == self.packets and not self.not_in_source

    def add(self, decoded: Frame, source: PacketsByTime) -> None:
        """Compare one decoded frame with the packets it was made from.

        Raises SectionError for a frame that never was packets.
        """
        back = packets_of(decoded)
        self.frames += 1
        self.packets += len(back)
        given = source.take(back[0], len(back)) if back else []
        if given is None:
            self.not_in_source += 1
            return
        self.identical_packets += sum(a.payload == b.payload for a, b in zip(given, back, strict=True))
        for original in frames_of(given, decoded.sensor, f"packets:{MAX_PACKETS}"):
            self._compare(original, decoded)

    def _compare(self, original: Frame, decoded: Frame) -> None:
        if original.range.shape != decoded.range.shape:
            raise SourceError(
                f"frame {decoded.index} of the recording has {decoded.width} columns, the packets of that time have "
                f"{original.width}: this recording was not made from this source"
            )
        self.errors.add(original.range, decoded.range)

    def result(self) -> dict[str, Any]:
        """All of it as plain values."""
        errors = self.errors
        return {
            "frames": self.frames,
            "frames_not_in_source": self.not_in_source,
            "packets": self.packets,
            "packets_identical": self.packets_identical,
            "identical_packets": self.identical_packets,
            "points": errors.points,
            "max_error_m": errors.max_error_m,
            "rmse_m": errors.rmse_m,
            "lost": errors.lost,
            "invented": errors.invented,
        }
