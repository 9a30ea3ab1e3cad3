"""The file of an SQLite database: readable by its owner only, with a note next to it once tokens are needed.

The note stays when the database is deleted while the server runs, or restored from a copy without tokens. A server that
finds the note needs a token for every access; `serve --open` removes the note.
"""

from __future__ import annotations

import contextlib
import logging
import os
from pathlib import Path
from typing import Final, NamedTuple

import sqlalchemy as sa

from lidarcodec_server.migrations import StoreError

logger = logging.getLogger(__name__)

PRIVATE: Final = 0o600
BESIDE: Final = ("", "-wal", "-shm", "-journal")
NOTE: Final = "Tokens are needed here. Without this file, and without tokens in the database, anybody has access.\n"


def file_of(url: sa.URL) -> Path | None:
    """The file of a database; None if it is not a file."""
    if url.get_backend_name() != "sqlite" or url.database in (None, "", ":memory:"):
        return None
    return Path(str(url.database)).absolute()


def make(file: Path) -> None:
    """Make the file and its folder if they do not exist, and make the file private.

    Raises StoreError.
    """
    try:
        file.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    except OSError as error:
        raise StoreError(f"cannot create {file.parent}: {error.strerror}") from None
    try:
        os.close(os.open(file, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, PRIVATE))
    except OSError as error:
        raise StoreError(f"cannot open {file}: {error.strerror}") from None
    for name in BESIDE:
        close_to_others(Path(f"{file}{name}"))


class Opened(NamedTuple):
    """Device and inode of a database and of its write-ahead log. They tell these files from later files with the same
    names. log: None if there is no log"""

    database: tuple[int, int]
    log: tuple[int, int] | None


def opened(file: Path) -> Opened | None:
    """The files that have the database's name now; None if there is no database."""
    database = _identity(file)
    return None if database is None else Opened(database, _identity(_log_of(file)))


def remove_log(file: Path, of: Opened) -> None:
    """Remove the write-ahead log of a deleted database, before SQLite applies its pages to the new database.

    of: the earlier files. A log that belongs to the new database stays
    """
    if of.log is not None and _identity(_log_of(file)) == of.log:
        for name in ("-wal", "-shm"):
            Path(f"{file}{name}").unlink(missing_ok=True)


def _log_of(file: Path) -> Path:
    return Path(f"{file}-wal")


def _identity(file: Path) -> tuple[int, int] | None:
    try:
        found = file.stat()
    except OSError:
        return None
    return found.st_dev, found.st_ino


def close_to_others(file: Path) -> None:
    """Make a file readable by its owner only. A file of another user is not changed."""
    with contextlib.suppress(OSError):
        if file.stat().st_mode & 0o077:
            file.chmod(PRIVATE)
            logger.info("%s was readable by other users; this is now corrected", file)


def note_of(file: Path) -> Path:
    """The path of a database's note."""
    return file.with_name(f"{file.stem}.needs-tokens")


def write_note(file: Path) -> None:
    """Write the note. On a full disk an empty note is enough; if no note can be made, only the database has the
    fact.
    """
    note = note_of(file)
    try:
        if not note.exists():
            note.write_text(NOTE, encoding="utf-8")
    except OSError as error:
        if not note.exists():
            logger.warning("cannot write %s: %s", note, error.strerror)


def remove_note(file: Path) -> None:
    """Remove the note.

    Raises StoreError.
    """
    try:
        note_of(file).unlink(missing_ok=True)
    except OSError as error:
        raise StoreError(f"cannot remove {note_of(file)}: {error.strerror}") from None
