"""Messages of a rosbag2 in SQLite (.db3). The file is not trusted.

A schema can hold code: views, triggers and generated columns can compute anything for any time. So only plain tables
with the columns of a bag are read, and no code in the file is run. The work of each query is limited by the size of the
file, and so are the bytes it returns, because many rows of a hostile file may refer to the same bytes.
"""

from __future__ import annotations

import contextlib
import logging
import os
import sqlite3
from collections import Counter
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Final
from urllib.parse import quote

from lidarcodec.errors import SourceError
from lidarcodec.files.regular import open_regular
from lidarcodec.recording.records import MAX_RECORD
from lidarcodec.sources.magic import SQLITE_MAGIC

logger = logging.getLogger(__name__)

MAX_TOPICS: Final = 4096
MAX_MESSAGES: Final = 4_000_000
"""Most messages of a topic in one file: 110 hours of an HDL-64E."""
COLUMNS: Final = {
    "topics": ({"id", "name", "type"}, {"serialization_format", "offered_qos_profiles", "type_description_hash"}),
    "messages": ({"id", "topic_id", "timestamp", "data"}, set[str]()),
}
"""Table -> columns that it must have, and columns that it may have."""
_LIMITS: Final = {
    sqlite3.SQLITE_LIMIT_LENGTH: MAX_RECORD,
    sqlite3.SQLITE_LIMIT_SQL_LENGTH: 1 << 16,
    sqlite3.SQLITE_LIMIT_COLUMN: 64,
    sqlite3.SQLITE_LIMIT_EXPR_DEPTH: 32,
    sqlite3.SQLITE_LIMIT_COMPOUND_SELECT: 2,
    sqlite3.SQLITE_LIMIT_ATTACHED: 0,
    sqlite3.SQLITE_LIMIT_TRIGGER_DEPTH: 1,
}
_STEPS_AT_ONCE: Final = 10_000
_STEPS_BASE: Final = 10_000_000
_OPENING_STEPS: Final = 1_000_000
"""Instructions of SQLite's virtual machine. A table of the schema takes eight; a row of messages takes about ten, and
at least 20 bytes of the file."""


def is_database(path: Path) -> bool:
    """Whether a file is one of SQLite. Raises OSError."""
    with open_regular(path) as file:
        return file.read(len(SQLITE_MAGIC)) == SQLITE_MAGIC


def topics(path: Path) -> dict[str, str]:
    """Topic to type.

    Raises SourceError if this is no bag.
    """
    try:
        with closing(_open(path)) as database:
            rows = database.execute("SELECT name, type FROM topics LIMIT ?", (MAX_TOPICS,)).fetchall()
    except (sqlite3.Error, ValueError, OSError) as error:
        raise SourceError(f"{path} is not a rosbag2: {_reason(error)}") from None
    return {str(name)[:1024]: str(kind)[:1024] for name, kind in rows}


def messages(path: Path, topic: str, counts: Counter[str], warn: bool = True) -> Iterator[bytes]:
    """Messages of a topic by time. In a damaged database, messages that cannot be read are counted and logged."""
    lost = _Lost(path, counts, warn)
    if (beside := _not_read(path)) is not None:
        lost.add(f"{beside} beside it was not read; `sqlite3 {path} 'PRAGMA wal_checkpoint'` puts it in")
    try:
        left = path.stat().st_size
        with closing(_open(path)) as database:
            rows = _rows(database, topic, lost)
            for row in rows[:MAX_MESSAGES]:
                try:
                    found = database.execute("SELECT data FROM messages WHERE _rowid_ = ?", (row,)).fetchone()
                except sqlite3.DatabaseError as error:
                    _raise_if_too_long(error)
                    lost.add(_reason(error))
                    continue
                data = found[0] if found else None
                if not isinstance(data, bytes):
                    counts["bad scans"] += 1
                    continue
                left -= len(data)
                if left < 0:
                    lost.add("its messages share their bytes")
                    return
                yield data
            if len(rows) > MAX_MESSAGES:
                lost.add(f"it has more than {MAX_MESSAGES} messages")
    except (sqlite3.Error, ValueError, OSError) as error:
        lost.add(_reason(error))


def _rows(database: sqlite3.Connection, topic: str, lost: _Lost) -> list[int]:
    """Numbers of the rows of a topic by time. In a damaged table: rows before the damage, in the order of the table.

    The table's index is not used: with a damaged index, SQLite finds fewer rows without an error.
    """
    of_topic = (
        "SELECT messages._rowid_ FROM messages NOT INDEXED JOIN topics ON messages.topic_id = topics.id"
        " WHERE topics.name = ?"
    )
    by_time = " ORDER BY CAST(messages.timestamp AS INTEGER), messages._rowid_"
    rows: list[int] = []
    try:
        return [row for (row,) in database.execute(f"{of_topic}{by_time} LIMIT ?", (topic, MAX_MESSAGES + 1))]
    except sqlite3.DatabaseError as error:
        _raise_if_too_long(error)
        lost.add(_reason(error))
    with contextlib.suppress(sqlite3.DatabaseError):
        for (row,) in database.execute(f"{of_topic} LIMIT ?", (topic, MAX_MESSAGES + 1)):
            rows.append(row)
    return rows


def _raise_if_too_long(error: sqlite3.DatabaseError) -> None:
    if error.sqlite_errorcode == sqlite3.SQLITE_INTERRUPT:
        raise error


class _Lost:
    """Counts damage of a database and logs the first one."""

    def __init__(self, path: Path, counts: Counter[str], warn: bool) -> None:
        self._path, self._counts, self._warns = path, counts, warn

    def add(self, why: str) -> None:
        """Count one damage."""
        self._counts["damaged"] += 1
        if self._warns:
            self._warns = False
            logger.warning("%s is damaged, and a part of it was skipped: %s", self._path, why)


def _not_read(path: Path) -> str | None:
    """Name of the write-ahead log beside a database that a killed recorder left behind; None if there is none."""
    path = path.resolve()  # SQLite looks beside the target of a link
    for ending, head_bytes in (("-wal", 32), ("-journal", 512)):
        beside = path.with_name(path.name + ending)
        with contextlib.suppress(OSError):
            if beside.stat().st_size > head_bytes:
                return beside.name
    return None


class _Watch:
    """Ends a query that takes more instructions than a file of this size needs."""

    def __init__(self, path: Path) -> None:
        self._left = _OPENING_STEPS
        self._more = _STEPS_BASE + path.stat().st_size

    def opened(self) -> None:
        """The schema was read. Queries of the tables get a higher limit."""
        self._left = self._more

    def __call__(self) -> bool:
        self._left -= _STEPS_AT_ONCE
        return self._left < 0


def _open(path: Path) -> sqlite3.Connection:
    """The database, with its tables checked. Raises sqlite3.Error, ValueError, OSError."""
    database = sqlite3.connect(
        f"file:{quote(os.fspath(path))}?mode=ro&immutable=1", uri=True, check_same_thread=False, cached_statements=8
    )
    try:
        for limit, most in _LIMITS.items():
            database.setlimit(limit, most)
        watch = _Watch(path)
        database.set_progress_handler(watch, _STEPS_AT_ONCE)
        database.text_factory = lambda data: data.decode("utf-8", "backslashreplace")
        for setting in (
            "trusted_schema=OFF",
            "query_only=ON",
            "cell_size_check=ON",
            "mmap_size=0",
            "temp_store=MEMORY",
        ):
            database.execute(f"PRAGMA {setting}")
        _check_tables(database)
        watch.opened()
    except BaseException:
        database.close()
        raise
    return database


def _check_tables(database: sqlite3.Connection) -> None:
    """Raises ValueError unless the tables are plain, with the columns of a bag, and without computed columns."""
    plain = "SELECT name FROM sqlite_master WHERE type = 'table' AND sql LIKE 'CREATE TABLE%'"
    known = {str(name).lower() for (name,) in database.execute(plain)}
    for table, (needed, possible) in COLUMNS.items():
        if table not in known:
            raise ValueError(f"no table {table}")
        columns = {row[1]: row[6] for row in database.execute(f"PRAGMA table_xinfo({table})")}
        if any(columns.values()):
            raise ValueError(f"table {table} has computed columns, which are not read")
        if not needed <= set(columns) <= needed | possible:
            raise ValueError(f"table {table} has the columns {', '.join(sorted(columns))[:80]}")


def _reason(error: Exception) -> str:
    return "opening it takes more than a bag can need" if str(error) == "interrupted" else str(error)
