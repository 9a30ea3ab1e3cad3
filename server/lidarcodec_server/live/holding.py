"""Hold: a lock on the folder of a recording. Several servers may have one folder of recordings.

A server that records holds the folder alone, one that plays holds it together with others, and deleting needs it alone.
The lock is the system's: it ends with the process, whatever ends that.
"""

from __future__ import annotations

import errno
import fcntl
import os
import time
from pathlib import Path
from typing import Final, Self

WAIT_S: Final = 0.5
"""How long a taken lock is tried again: a server that lists recordings takes each for a moment to see if it is held."""
_LOOK_S: Final = 0.02
_UNKNOWN: Final = frozenset({errno.EBADF, errno.EINVAL, errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP})
"""What file systems answer whose folders cannot be locked, such as some on a network: there nothing counts as held."""


class Hold:
    """A lock that was taken; `close` gives it back."""

    def __init__(self, handle: int) -> None:
        self._handle: int | None = handle

    @classmethod
    def of(cls, folder: Path, *, alone: bool, wait_s: float = WAIT_S) -> Self | None:
        """The lock of a folder; None if somebody else has it for longer than `wait_s`.

        Raises OSError if the folder cannot be opened.
        """
        hold = cls(os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC))
        try:
            taken = hold._take(fcntl.LOCK_EX if alone else fcntl.LOCK_SH, time.monotonic() + wait_s)
        except BaseException:
            hold.close()
            raise
        if taken:
            return hold
        hold.close()
        return None

    def close(self) -> None:
        """Give the lock back; harmless when called twice."""
        handle, self._handle = self._handle, None
        if handle is not None:
            os.close(handle)

    def _take(self, kind: int, until_s: float) -> bool:
        assert self._handle is not None
        while True:
            try:
                fcntl.flock(self._handle, kind | fcntl.LOCK_NB)
            except BlockingIOError:
                if time.monotonic() >= until_s:
                    return False
                time.sleep(_LOOK_S)
            except OSError as error:
                if error.errno not in _UNKNOWN:
                    raise
                return True
            else:
                return True


def held_alone(folder: Path) -> bool:
    """Whether somebody holds a folder alone, which is whether it is being recorded into."""
    try:
        hold = Hold.of(folder, alone=False, wait_s=0.0)
    except OSError:  # deleted meanwhile
        return False
    if hold is None:
        return True
    hold.close()
    return False
