"""locked, alone_in: let only one command at a time change a folder."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import logging
import os
import stat
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from lidarcodec.errors import SourceError

logger = logging.getLogger(__name__)

WAIT_S: Final = 30.0
"""Longest wait for another call; a call of `certs` takes a second or two."""
_LOOK_S: Final = 0.05
_UNKNOWN: Final = frozenset({errno.EBADF, errno.EINVAL, errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP})
"""Error codes of file systems without locks on folders, such as some network file systems."""


@contextmanager
def locked(folder: Path, wait_s: float = WAIT_S) -> Iterator[None]:
    """Hold a lock on a folder within the block. The operating system releases it if the process ends.

    Raises SourceError when another process holds it for longer than `wait_s`, or the folder cannot be opened.
    """
    handle = _opened(folder)
    try:
        _take(handle, folder, time.monotonic() + wait_s)
        yield
    finally:
        os.close(handle)


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Hold a lock on a folder that is there for as long as it holds something.

    Raises SourceError when another process holds it, it cannot be made, or somebody else made it.
    """
    while True:
        try:
            folder.mkdir(0o700, parents=True, exist_ok=True)
        except OSError as error:
            raise SourceError(f"cannot make {folder}: {error.strerror or error}") from None
        handle = _opened(folder)
        try:
            _check_ours(folder)
            _take(handle, folder, time.monotonic())
            if not _is_at(handle, folder):  # who held it has removed it
                continue
            try:
                yield
            finally:
                with contextlib.suppress(OSError):
                    folder.rmdir()
        finally:
            os.close(handle)
        return


def _check_ours(folder: Path) -> None:
    """Raise SourceError if it is a link, or another user made it: who did may put links into it, and what is read from
    it decides which files are removed. A folder that took its place meanwhile is looked at again."""
    try:
        here = folder.lstat()  # what is a folder of ours now cannot be exchanged by others
    except OSError:  # who held it has removed it
        return
    ours = here.st_uid == os.geteuid() or here.st_uid == _owner_in(folder.parent)
    if not stat.S_ISDIR(here.st_mode) or not ours:
        raise SourceError(f"{folder} is a link, or belongs to another user: remove it, or take another output")


def _owner_in(folder: Path) -> int:
    """Owner of what we make in a folder: some file systems give all to one user. Raises SourceError."""
    try:
        with tempfile.TemporaryDirectory(dir=folder, prefix=".lidarcodec-") as made:
            return Path(made).stat().st_uid
    except OSError as error:
        raise SourceError(f"cannot write in {folder}: {error.strerror or error}") from None


def _is_at(handle: int, folder: Path) -> bool:
    """Whether an open folder still has its name."""
    try:
        return os.path.samestat(os.fstat(handle), folder.stat())
    except OSError:
        return False


def _opened(folder: Path) -> int:
    try:
        return os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    except OSError as error:
        raise SourceError(f"cannot open {folder}: {error.strerror or error}") from None


def _take(handle: int, folder: Path, until_s: float) -> None:
    while True:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() >= until_s:
                raise SourceError(f"another command is changing {folder}: wait until it has ended") from None
            time.sleep(_LOOK_S)
        except OSError as error:
            if error.errno not in _UNKNOWN:
                raise SourceError(f"cannot lock {folder}: {error.strerror or error}") from None
            logger.warning("%s cannot be locked: do not change it with another command at the same time", folder)
            return
        else:
            return
