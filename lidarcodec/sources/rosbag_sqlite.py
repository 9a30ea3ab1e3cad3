"""Messages of a rosbag2 in SQLite (.db3), opened so that nothing of it can change and nothing large is taken unread."""

from __future__ import annotations

import sqlite3
from collections import Counter
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from urllib.parse import quote

from lidarcodec.errors import SourceError
from lidarcodec.recording.records import MAX_RECORD
from lidarcodec.sources.table import SQLITE_MAGIC


def is_database(path: Path) -> bool:
    """Whether a file is one of SQLite. Raises OSError."""
    with path.open("rb") as file:
        return file.read(len(SQLITE_MAGIC)) == SQLITE_MAGIC


def topics(path: Path) -> dict[str, str]:
    """Topic to type.

    Raises SourceError if this is no bag.
    """
    try:
        with closing(_open(path)) as database:
            _check_tables(database)
            rows = database.execute("SELECT name, type FROM topics LIMIT 4096").fetchall()
    except (sqlite3.Error, ValueError) as error:
        raise SourceError(f"{path} is no rosbag2: {error}") from None
    return {str(name): str(kind) for name, kind in rows}


def messages(path: Path, topic: str, counts: Counter[str]) -> Iterator[bytes]:
    """Messages of a topic by time. A database that breaks off, or is damaged, gives what is before that."""
    try:
        with closing(_open(path)) as database:
            _check_tables(database)
            rows = database.execute(
                "SELECT messages.data FROM messages JOIN topics ON messages.topic_id = topics.id"
                " WHERE topics.name = ? ORDER BY messages.timestamp, messages.id",
                (topic,),
            )
            for (data,) in rows:
                if isinstance(data, bytes):
                    yield data
                else:
                    counts["bad scans"] += 1
    except (sqlite3.Error, ValueError):
        counts["damaged"] += 1


def _open(path: Path) -> sqlite3.Connection:
    database = sqlite3.connect(f"file:{quote(str(path))}?mode=ro&immutable=1", uri=True, check_same_thread=False)
    database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_RECORD)
    database.text_factory = lambda data: data.decode("utf-8", "backslashreplace")
    return database


def _check_tables(database: sqlite3.Connection) -> None:
    """Raises ValueError for a database in which something else looks like the tables of a bag: a view can go on for
    ever, and nothing ends a query that does."""
    tables = "SELECT name FROM sqlite_master WHERE type = 'table' AND sql LIKE 'CREATE TABLE%'"
    known = {name.lower() for (name,) in database.execute(tables)}
    for name in ("topics", "messages"):
        if name not in known:
            raise ValueError(f"no table {name}")
