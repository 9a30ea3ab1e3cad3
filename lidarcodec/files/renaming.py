"""Renames that never replace a file, and swaps of two names, in one step: Python has no functions for them.

>>> import tempfile
>>> folder = Path(tempfile.mkdtemp())
>>> made = folder / "made"
>>> _ = made.write_text("new")
>>> rename_new(made, folder / "name")
>>> (folder / "name").read_text(), made.exists()
('new', False)
"""

from __future__ import annotations

import contextlib
import errno
import os
from pathlib import Path
from typing import Final

_HERE: Final = -100
"""AT_FDCWD of Linux: names are as the process sees them."""
_NO_REPLACE: Final = 1
_EXCHANGE: Final = 2
_UNKNOWN: Final = (errno.ENOSYS, errno.EINVAL, errno.ENOTSUP, errno.EOPNOTSUPP)
"""Errors of systems and file systems without such renames."""


def rename_new(old: Path, new: Path) -> None:
    """Give a file or folder a new name that nothing has yet.

    Raises FileExistsError if the name is taken, also by a broken link; OSError.
    """
    try:
        _renameat2(old, new, _NO_REPLACE)
    except OSError as error:
        if error.errno not in _UNKNOWN:
            raise
        if old.is_dir():
            if os.path.lexists(new):
                raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(new)) from None
            old.rename(new)  # takes the place of an empty folder at most
            return
        os.link(old, new, follow_symlinks=False)
        old.unlink()


def exchange(one: Path, other: Path) -> bool:
    """Swap two names in one step; False if this system cannot, and nothing has changed.

    Raises OSError.
    """
    try:
        _renameat2(one, other, _EXCHANGE)
    except OSError as error:
        if error.errno in _UNKNOWN:
            return False
        raise
    return True


def _renameat2(old: Path, new: Path, flags: int) -> None:
    import ctypes

    try:
        call = ctypes.CDLL(None, use_errno=True).renameat2
    except (AttributeError, OSError, TypeError):
        raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS)) from None
    if call(_HERE, os.fsencode(old), _HERE, os.fsencode(new), flags) != 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number), str(old), None, str(new))


def synced(path: Path) -> None:
    """Put a file, or the names in a folder, on the disk, where the file system can."""
    with contextlib.suppress(OSError):
        handle = os.open(path, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
