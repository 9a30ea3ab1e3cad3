"""Frames that are missing between those of a stream, by their numbers.

>>> from lidarcodec.message import Message
>>> numbers = Numbers()
>>> for index in (4, 5, 9):
...     numbers.add(Message(codec=0, stream_id=7, frame_index=index, stamp_ns=index * 10**8, key=True,
...                         width=1, packets=1, sections=()))
>>> numbers.frames, numbers.missing, numbers.longest()
(3, 3, Hole(from_ns=500000000, to_ns=900000000, frames=3))
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple, Protocol

MAX_HOLES: Final = 1000
"""Most holes that are listed; all are counted."""


class Numbered(Protocol):
    """A message or its header."""

    @property
    def stream_id(self) -> int: ...
    @property
    def frame_index(self) -> int: ...
    @property
    def frame_count(self) -> int: ...
    @property
    def stamp_ns(self) -> int: ...


class Hole(NamedTuple):
    """Frames that are missing between two frames, by their numbers. Times: the stamps of those two, in ns"""

    from_ns: int
    to_ns: int
    frames: int

    @property
    def seconds(self) -> float:
        """Time between the two frames."""
        return (self.to_ns - self.from_ns) / 1e9


class Numbers:
    """Counts frames, and finds missing ones by their numbers. They begin again with each start of a sensor."""

    def __init__(self) -> None:
        self.frames = self.missing = 0
        self.holes: list[Hole] = []
        self._last: Numbered | None = None

    def add(self, message: Numbered) -> None:
        """Take the next message."""
        self.frames += message.frame_count
        last, self._last = self._last, message
        if last is None or last.stream_id != message.stream_id:
            return
        missing = message.frame_index - last.frame_index - last.frame_count
        if missing <= 0:
            return
        self.missing += missing
        if len(self.holes) < MAX_HOLES:
            self.holes.append(Hole(last.stamp_ns, message.stamp_ns, missing))

    def longest(self) -> Hole | None:
        """The longest hole of those that are listed; None without any."""
        return longest_of(self.holes)


def longest_of(holes: Sequence[Hole]) -> Hole | None:
    """The longest hole; None without any."""
    return max(holes, key=lambda hole: hole.seconds, default=None)
