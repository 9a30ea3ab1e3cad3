"""UnderWay: the recently sent messages, and those whose report is still missing."""

from __future__ import annotations

from collections import OrderedDict
from typing import Final, NamedTuple

REMEMBERED: Final = 16


class Sent(NamedTuple):
    """A sent message: its time, size, whether it is a key frame, whether it can be decoded without others, its
    number of frames, and the followed receiver."""

    at_s: float
    size: int
    key: bool
    alone: bool
    frames: int
    to: str | None


class UnderWay:
    """The last messages. Not thread-safe: `Flight` holds a lock.

    unreported: frames of messages that the followed receiver never reported although it reported a later one. They
                were lost, or replaced by a later one in the receiver's ring
    """

    def __init__(self) -> None:
        self._sent: OrderedDict[int, Sent] = OrderedDict()
        self._open: set[int] = set()
        self._late: set[int] = set()  # given up: no measurement, even if they arrive later
        self.unreported = 0

    def __len__(self) -> int:
        """Number of messages without a report yet."""
        return len(self._open)

    def put(self, index: int, sent: Sent) -> list[Sent]:
        """A message is sent. It waits for a report if a receiver is followed. Returns messages that it replaces."""
        self._sent[index] = sent
        if sent.to is not None:
            self._open.add(index)
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

    def arrived(self, index: int, name: str) -> None:
        """A message was reported: earlier ones to the same receiver count as unreported."""
        self._pop(index)
        for one in [one for one in self._sent if one < index]:
            self.missed(self._pop(one), name)

    def missed(self, sent: Sent, by: str | None) -> None:
        """A message is forgotten. by: receiver that reported a later one instead"""
        if sent.to is not None and sent.to == by:
            self.unreported += sent.frames

    def waiting(self) -> list[Sent]:
        """The messages without a report yet, oldest first."""
        return [self._sent[one] for one in sorted(self._open)]

    def give_up(self) -> None:
        """Stop waiting for all of them."""
        self._late.update(self._open)
        self._open.clear()

    def switched(self) -> None:
        """Another receiver is followed: stop waiting, and do not use recent messages as measurements."""
        self._open.clear()
        self._late.update(self._sent)

    def _pop(self, index: int) -> Sent:
        self._open.discard(index)
        self._late.discard(index)
        return self._sent.pop(index)
