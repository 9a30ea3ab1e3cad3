"""A flight for tests: time that goes when told to, and messages whose checksum is told by their index."""

from __future__ import annotations

from collections.abc import Container

from lidarcodec.apps.publisher.flight import Flight


def checksum(index: int) -> int:
    """What stands for the checksum of a message."""
    return index ^ 0xC0FFEE


class Clock:
    """Time that goes when told to."""

    now = 1000.0

    def __call__(self) -> float:
        return self.now


class Path(Flight):
    """A flight that is told indices only."""

    def put(self, index: int, size: int = 0, frames: int = 1, **how: bool) -> None:
        """A message is sent."""
        self.sent(index, checksum(index), size, frames, **how)

    def told(self, name: str, index: int, held_s: float = 0.0, had: Container[int] = ()) -> None:
        """A receiver reports a message that it received. had: indices that had arrived there before"""
        self.reported(name, index, checksum(index), held_s, lambda one: one in had)
