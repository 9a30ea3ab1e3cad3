"""Hold: a lock on a folder, such as that of a recording. Several servers may share a folder of recordings.

Recording and deleting need an exclusive lock, and playing needs a shared one. The operating system keeps the lock, so
it ends with the process, even after a crash.
"""

from __future__ import annotations

import errno
import fcntl
import os
import time
from pathlib import Path
from typing import Final, Self

WAIT_S: Final = 0.5
"""How long to retry: a server that lists recordings locks each of them briefly to see whether it is in use."""
_LOOK_S: Final = 0.02
_UNKNOWN: Final = frozenset({errno.EBADF, errno.EINVAL, errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP})
"""Errors of file systems without locks on folders, such as some network file systems. There nothing counts as held."""


class Hold:
    """A lock in use; `close` releases it."""

    def __init__(self, handle: int) -> None:
        self._handle: int | None = handle

    @classmethod
    def of(cls, folder: Path, *, alone: bool, wait_s: float = WAIT_S) -> Self | None:
        """Lock a folder; None if another process holds it for longer than `wait_s`.

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
        """Release the lock. A second call does nothing."""
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
    """Whether a process has an exclusive lock on a folder, so it is recording into it."""
    try:
        hold = Hold.of(folder, alone=False, wait_s=0.0)
    except OSError:  # deleted meanwhile
        return False
    if hold is None:
        return True
    hold.close()
    return False
