"""UnderWay: the recently sent messages, and those whose report is still missing.

A message is *open* until it is reported, or overdue. One that is overdue may still arrive; it is known to be lost when
a later one is reported that says so.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NamedTuple

from lidarcodec.settings import MAX_PARTS

REMEMBERED: Final = 4 * MAX_PARTS


@dataclass(frozen=True)
class Sent:
    """A sent message: its index, time, size, whether it is a key frame, its number of frames, the followed receiver,
    and the index of the first part of its turn (its own of a whole frame)."""

    index: int
    at_s: float
    size: int
    key: bool
    frames: int
    to: str | None
    turn: int = -1


class Landed(NamedTuple):
    """What a report says of earlier messages: those that arrived too, and those that are lost."""

    arrived: list[Sent]
    lost: list[Sent]


class UnderWay:
    """The last messages. Not thread-safe: `Flight` holds a lock.

    unreported: frames of messages that the followed receiver did not receive although it reported a later one. They
                were lost, or replaced by a later one in the receiver's ring
    """

    def __init__(self) -> None:
        self._sent: OrderedDict[int, Sent] = OrderedDict()
        self._open: set[int] = set()
        self._late: set[int] = set()  # given up after a silence: no measurement, even if they arrive later
        self.unreported = 0

    def __len__(self) -> int:
        """Number of open messages."""
        return len(self._open)

    @property
    def turns(self) -> int:
        """Number of turns with open messages."""
        return len({self._sent[index].turn for index in self._open})

    def put(self, sent: Sent) -> list[Sent]:
        """A message is sent. It waits for a report if a receiver is followed. Returns messages that it replaces."""
        self._sent[sent.index] = sent
        if sent.to is not None:
            self._open.add(sent.index)
        forgotten = []
        while len(self._sent) > REMEMBERED:
            forgotten.append(self._pop(next(iter(self._sent))))
        return forgotten

    def find(self, index: int) -> Sent | None:
        """A recent message that the followed receiver has not reported; None if there is none."""
        return self._sent.get(index)

    def is_late(self, index: int) -> bool:
        """Whether a message was given up, or sent while another receiver was followed."""
        return index in self._late

    def arrived(self, index: int, name: str, has: Callable[[int], bool]) -> Landed:
        """A receiver reported a message. has: whether an earlier one arrived there, by its index"""
        self._pop(index)
        earlier = [self._pop(one) for one in [one for one in self._sent if one < index]]
        landed = Landed([one for one in earlier if has(one.index)], [one for one in earlier if not has(one.index)])
        for one in landed.lost:
            self.missed(one, name)
        return landed

    def missed(self, sent: Sent, by: str | None) -> None:
        """A message is forgotten. by: receiver that reported a later one instead"""
        if sent.to is not None and sent.to == by:
            self.unreported += sent.frames

    def waiting(self) -> list[Sent]:
        """The open messages, oldest first."""
        return [self._sent[one] for one in sorted(self._open)]

    def unresolved(self, name: str | None) -> list[Sent]:
        """The messages to a receiver, open or overdue, in the order in which they were sent."""
        return [one for one in self._sent.values() if one.to is not None and one.to == name]

    def is_open(self, index: int) -> bool:
        """Whether a message waits for its report."""
        return index in self._open

    def overdue(self, index: int) -> None:
        """Stop waiting for a message."""
        self._open.discard(index)

    def give_up(self) -> None:
        """Stop waiting for all of them."""
        self._late.update(self._sent)
        self._open.clear()

    def _pop(self, index: int) -> Sent:
        self._open.discard(index)
        self._late.discard(index)
        return self._sent.pop(index)
