"""SpareHandles: open files kept in reserve, so that a file can be opened when all others are taken.

A process that accepts connections can be brought to its limit of open files by strangers who only connect. What it has
to write must not depend on them: a recording begins its next file, and the watchdog gets the state.
"""

from __future__ import annotations

import contextlib
import errno
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final, TypeVar

T = TypeVar("T")

FULL: Final = (errno.EMFILE, errno.ENFILE)
"""The process, or the whole system, may open no more files."""


class SpareHandles:
    """Up to `count` handles in reserve. For one thread at a time."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._handles: list[int] = []

    def fill(self) -> bool:
        """Take the handles that are missing; returns whether all are there."""
        with contextlib.suppress(OSError):
            while len(self._handles) < self._count:
                self._handles.append(os.open(os.devnull, os.O_RDONLY | os.O_CLOEXEC))
        return len(self._handles) == self._count

    def opened(self, open_it: Callable[[], T]) -> T:
        """What `open_it` gives, which takes the place of a spare handle if no other is free.

        Raises the OSError of `open_it`.
        """
        while True:
            try:
                found = open_it()
            except OSError as error:
                if error.errno not in FULL or not self._handles:
                    raise
            else:
                self.fill()
                return found
            os.close(self._handles.pop())

    @contextmanager
    def lent(self) -> Iterator[None]:
        """Free all handles within the block, and take them again. Keep it short: others may take them, too."""
        self.close()
        try:
            yield
        finally:
            self.fill()

    def close(self) -> None:
        """Give the handles back."""
        while self._handles:
            os.close(self._handles.pop())
