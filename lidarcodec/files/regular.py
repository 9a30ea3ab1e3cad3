"""Input files are regular files. The one function that opens them, so that no reader waits for a pipe without end.

Opening a pipe (FIFO) waits until somebody writes to it, and a device may have no end. Files are also read twice, or
from their middle, which neither allows. So they are refused at once, with one sentence.

>>> open_regular(Path("/dev/zero"))
Traceback (most recent call last):
lidarcodec.files.regular.NotRegularError: [Errno 22] it is a device; use a regular file: '/dev/zero'
"""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO, Final

_KINDS: Final = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


class NotRegularError(OSError):
    """There is something at a path that is no regular file; `strerror` says what it is."""


def check_regular(path: Path) -> None:
    """Raise NotRegularError if a path leads to something that is no regular file, another OSError if to nothing."""
    _check(path.stat().st_mode, path)


def open_regular(path: Path, *, buffering: int = -1) -> BinaryIO:
    """A regular file, opened to be read as bytes; its `name` is the path. A link to one counts as one.

    buffering: as of the function `open`
    Raises NotRegularError for a pipe, a device, a socket or a folder, without waiting for it; other OSErrors as `open`.
    """
    check_regular(path)  # first: a socket cannot be opened at all, and opening a device may do something
    return open(path, "rb", buffering=buffering, opener=_opener)


def _opener(path: str, flags: int) -> int:
    """A descriptor of what is there now: it may be something else than a moment before, and must not be waited for."""
    handle = os.open(path, flags | os.O_NONBLOCK | os.O_NOCTTY)
    try:
        _check(os.fstat(handle).st_mode, Path(path))
    except BaseException:
        os.close(handle)
        raise
    return handle


def _check(mode: int, path: Path) -> None:
    if not stat.S_ISREG(mode):
        kind = _KINDS.get(stat.S_IFMT(mode), "something else")
        raise NotRegularError(errno.EINVAL, f"it is {kind}; use a regular file", str(path))
