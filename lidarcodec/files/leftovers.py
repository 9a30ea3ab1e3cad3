"""Hidden files of outputs: their names, and the removal of those whose program was killed.

A program holds a lock on each hidden file that it writes, which ends with the program. What has such a name, is not
locked and was not touched for a while is left over.
"""

from __future__ import annotations

import contextlib
import fcntl
import logging
import os
import re
import secrets
import shutil
import stat
import time
from pathlib import Path
from typing import Final

logger = logging.getLogger(__name__)

_NAME_CHARACTERS: Final = 40
"""Of a hidden name, those that tell what it belongs to: a long name must not become too long."""
_RANDOM_BYTES: Final = 6
OLD_S: Final = 60.0
"""A younger file may be one that is not locked yet."""


def hidden_name(path: Path, suffix: str) -> Path:
    """A new hidden name beside an output.

    >>> hidden_name(Path("a/drive.mcap"), ".mcap").name.startswith(".drive.")
    True
    """
    return path.with_name(f".{path.stem[:_NAME_CHARACTERS]}.{secrets.token_hex(_RANDOM_BYTES)}{suffix}")


def held(hidden: Path) -> int | None:
    """A handle that locks a hidden file or folder until it is closed; None on file systems without locks."""
    return _locked(hidden, fcntl.LOCK_SH)


def let_go(handle: int) -> None:
    """Close a handle of `held`."""
    with contextlib.suppress(OSError):
        os.close(handle)


def remove_made(path: Path) -> None:
    """Remove a file or folder that was made here."""
    try:
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)
    except OSError as error:
        if os.path.lexists(path):  # a folder that cannot be written to refuses this, too, for what never was there
            logger.warning("%s could not be removed: %s", path, error.strerror or error)


def remove_leftovers(path: Path, suffix: str) -> None:
    """Remove the files that killed programs left of outputs of this name. What cannot be looked at stays."""
    name = re.compile(
        rf"\.{re.escape(path.stem[:_NAME_CHARACTERS])}\.[0-9a-f]{{{2 * _RANDOM_BYTES}}}{re.escape(suffix)}"
    )
    try:
        found = [one for one in path.parent.iterdir() if name.fullmatch(one.name)]
    except OSError:
        return
    for one in found:
        with contextlib.suppress(OSError):
            _remove(one)


def _remove(hidden: Path) -> None:
    about = os.lstat(hidden)
    old = time.time() - about.st_mtime > OLD_S
    if not (stat.S_ISREG(about.st_mode) and about.st_uid == os.geteuid() and old):
        return
    handle = _locked(hidden, fcntl.LOCK_EX)
    if handle is None:
        return
    try:
        if os.path.samestat(os.fstat(handle), about):
            hidden.unlink()
            logger.info("%s was left over by a command that was killed, and is removed", hidden)
    finally:
        os.close(handle)


def _locked(hidden: Path, kind: int) -> int | None:
    try:
        handle = os.open(hidden, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK)
    except OSError:
        return None
    try:
        fcntl.flock(handle, kind | fcntl.LOCK_NB)
    except OSError:
        let_go(handle)
        return None
    return handle
