"""UnderWay: the messages that were put lately, and those of them whose report is waited for."""

from __future__ import annotations

from collections import OrderedDict
from typing import Final, NamedTuple

REMEMBERED: Final = 16


class Sent(NamedTuple):
    """A message that was put: when, how large, whether a key frame, whether it can be decoded without others, of how
    many frames, and who was followed."""

    at_s: float
    size: int
    key: bool
    alone: bool
    frames: int
    to: str | None


class UnderWay:
    """The last messages. Not thread-safe: `Flight` holds a lock.

    unreported: frames of messages that who was followed never reported, though a later one; they were lost on the way,
                or a later one took their place in the receiver's ring
    """

    def __init__(self) -> None:
        self._sent: OrderedDict[int, Sent] = OrderedDict()
        self._open: set[int] = set()
        self._late: set[int] = set()  # were given up: when they arrive after all they say nothing of the path
        self.unreported = 0

    def __len__(self) -> int:
        """Messages that are waited for."""
        return len(self._open)

    def put(self, index: int, sent: Sent) -> list[Sent]:
        """A message is put, and waited for where somebody is followed. The messages that are forgotten for it."""
        self._sent[index] = sent
        if sent.to is not None:
            self._open.add(index)
        forgotten = []
        while len(self._sent) > REMEMBERED:
            forgotten.append(self._pop(next(iter(self._sent))))
        return forgotten

    def find(self, index: int) -> Sent | None:
        """A message of lately that was not reported by who is followed."""
        return self._sent.get(index)

    def is_late(self, index: int) -> bool:
        """Whether a message was given up, or put while another receiver was followed."""
        return index in self._late

    def arrived(self, index: int, name: str) -> None:
        """A message was reported; those before that went to the same receiver were not."""
        self._pop(index)
        for one in [one for one in self._sent if one < index]:
            self.missed(self._pop(one), name)

    def missed(self, sent: Sent, by: str | None) -> None:
        """A message is forgotten; by: who did not report it, though a later one."""
        if sent.to is not None and sent.to == by:
            self.unreported += sent.frames

    def waiting(self) -> list[Sent]:
        """The messages that are waited for, oldest first."""
        return [self._sent[one] for one in sorted(self._open)]

    def give_up(self) -> None:
        """Wait for none of them any more."""
        self._late.update(self._open)
        self._open.clear()

    def switched(self) -> None:
        """Another receiver is followed: no message is waited for, and those of lately say nothing of its path."""
        self._open.clear()
        self._late.update(self._sent)

    def _pop(self, index: int) -> Sent:
        self._open.discard(index)
        self._late.discard(index)
        return self._sent.pop(index)
