"""in_sent_order: the messages of a recording sorted by frame number, for messages that arrived late.

>>> waiting = _Waiting()
>>> [index for number in (5, 7, 6, 8) for index, _ in waiting.take(1, number, 1, (number, b""))]
[]
>>> [index for index, _ in waiting.rest()]
[5, 6, 7, 8]
"""

from __future__ import annotations

from bisect import insort
from collections.abc import Callable, Iterable, Iterator
from typing import Final

from lidarcodec import wire
from lidarcodec.errors import DecodeError

REACH: Final = 8
"""A message that is late by at most so many messages can be sorted. No more are held in memory."""

NONE: Final = -1

Stamped = tuple[int, bytes]


def in_sent_order(messages: Iterable[Stamped], too_late: Callable[[], object] = lambda: None) -> Iterator[Stamped]:
    """The messages of a stream sorted by frame number, if none is more than REACH messages late.

    A recorder writes messages in order of arrival. Decoders need them in the order in which they were sent.
    messages: messages of one channel, each with its time in ns. An unreadable message keeps its position.
    too_late: called for each message that is too late to be sorted: frame numbers decrease there
    """
    waiting = _Waiting(too_late)
    for stamped in messages:
        try:
            header = wire.peek(stamped[1])
        except DecodeError:
            yield from waiting.rest()
            yield stamped
        else:
            yield from waiting.take(header.stream_id, header.frame_index, header.frame_count, stamped)
    yield from waiting.rest()


class _Waiting:
    """The newest messages of one run of a stream, sorted by frame number."""

    def __init__(self, too_late: Callable[[], object] = lambda: None) -> None:
        self._too_late = too_late
        self._stream: int | None = None
        self._messages: list[tuple[int, int, Stamped]] = []
        self._taken = 0
        self._given = NONE  # frame number of the message that was given last

    def take(self, stream: int, index: int, frames: int, stamped: Stamped) -> Iterator[Stamped]:
        """Take a message of `frames` frames; returns the messages that are now in order."""
        newest = self._messages[-1][0] if self._messages else self._given
        is_other = stream != self._stream
        is_far_behind = not is_other and newest - index > REACH * frames
        if is_other or is_far_behind:
            yield from self.rest()
            self._given = NONE
        if is_far_behind or index < self._given:
            self._too_late()
        self._stream = stream
        self._taken += 1
        insort(self._messages, (index, self._taken, stamped))
        if len(self._messages) > REACH:
            yield self._first()

    def rest(self) -> Iterator[Stamped]:
        """All waiting messages, in order."""
        while self._messages:
            yield self._first()

    def _first(self) -> Stamped:
        self._given, _, stamped = self._messages.pop(0)
        return stamped
