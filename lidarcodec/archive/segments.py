"""Segments: parts of an input of 30 to 60 seconds, cut between frames.

>>> stamps = [number * 10**8 for number in range(900)]  # 90 s at 10 Hz
>>> [(one.first, one.last) for one in cut([(stamp, 348) for stamp in stamps], 40.0)]
[(0, 139200), (139200, 278400), (278400, 313200)]
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from typing import Any, Final

from lidarcodec.packet import Packet

SECONDS: Final = 40.0
MAX_SECONDS: Final = 600.0
"""Usual and greatest length of a segment."""
MAX_FRAMES: Final = 20_000
"""Most frames of a segment: a frame may be one packet."""
_GAP_NS: Final = 5 * 10**9
"""A segment ends where the sensor paused for so long, or its clock went back."""


@dataclass(frozen=True)
class Segment:
    """A part of an input. first, last: numbers of its first data packet and of the one after its last one
    first_ns, last_ns: stamps of its first and last frame;  frames: number of frames
    """

    first: int
    last: int
    first_ns: int
    last_ns: int
    frames: int

    def plain(self) -> dict[str, int]:
        """The fields as plain values."""
        return asdict(self)

    @classmethod
    def of(cls, plain: dict[str, Any]) -> Segment:
        """The segment of plain values. Raises KeyError, ValueError or TypeError if they are none."""
        values = {name: plain[name] for name in cls.__dataclass_fields__}
        if not all(type(value) is int and abs(value) < 1 << 63 for value in values.values()):
            raise ValueError("a number of a segment is out of range")
        found = cls(**values)
        if not (0 <= found.first <= found.last and found.first_ns <= found.last_ns and 0 < found.frames <= MAX_FRAMES):
            raise ValueError("a segment ends before it begins, or has no frame, or too many")
        return found


def cut(frames: Iterable[tuple[int, int]], seconds: float = SECONDS) -> Iterator[Segment]:
    """Segments of frames, given as (stamp in ns, number of data packets)."""
    first = at = count = 0
    first_ns = last_ns = 0
    for stamp_ns, packets in frames:
        paused = not 0 <= stamp_ns - last_ns <= _GAP_NS
        if count and (paused or stamp_ns - first_ns >= seconds * 1e9 or count >= MAX_FRAMES):
            yield Segment(first, at, first_ns, last_ns, count)
            first, count = at, 0
        if not count:
            first_ns = stamp_ns
        last_ns = stamp_ns
        at, count = at + packets, count + 1
    if count:
        yield Segment(first, at, first_ns, last_ns, count)


def packets_in(packets: Iterable[Packet], segment: Segment) -> Iterator[Packet]:
    """The packets of a segment. Position packets belong to the data packet before them, the first ones to segment 0."""
    number = 0
    for packet in packets:
        if not packet.position:
            if number >= segment.last:
                return
            number += 1
        if number > segment.first or (packet.position and number == segment.first == 0):
            yield packet
