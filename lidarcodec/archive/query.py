"""SQL over the table of frames, by DuckDB. Nothing is downloaded but the table: the store is read through obstore."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from threading import Timer
from types import MappingProxyType
from typing import Any, Final, NamedTuple, TypeVar

from lidarcodec.archive.index import tables_to_read
from lidarcodec.archive.stores.base import Store
from lidarcodec.archive.table import Tables, duckdb_errors, with_tables
from lidarcodec.errors import SettingsError, SourceError

logger = logging.getLogger(__name__)

TRIES: Final = 3
"""So often a query is tried when tables were joined or replaced, and then removed, while it ran."""
_SHOWN: Final = 5
"""Most segments that are named in a warning."""
Found = TypeVar("Found")
Warn = Callable[..., None]
"""Takes a warning, as a method of a logger does."""


class Answer(NamedTuple):
    """Names of columns and rows of a query. lost: number of segments whose tables are lost, so that they have no row"""

    columns: list[str]
    rows: list[tuple[Any, ...]]
    lost: int


class Bounds(NamedTuple):
    """What a query may take: seconds, and MB of memory. It gets one thread, and no disk"""

    seconds: float
    megabytes: int

    def options(self) -> dict[str, str | int]:
        """As options of DuckDB."""
        return {"memory_limit": f"{self.megabytes}MB", "temp_directory": "", "threads": 1}

    @contextmanager
    def timed(self, connection: Any) -> Iterator[None]:
        """Ends what the connection does when the time is over."""
        timer = Timer(self.seconds, connection.interrupt)
        timer.daemon = True
        timer.start()
        try:
            yield
        finally:
            timer.cancel()


def query(store: Store, sql: str, bounds: Bounds | None = None, warn: Warn = logger.warning) -> Answer:
    """What a query over the table `frames` finds.

    bounds: by default it may take all memory and any time;  warn: called for segments whose tables are lost
    Raises SettingsError if it is wrong or takes more memory, SourceError for damaged tables, OSError, of these
    TimeoutError when the time is over.
    """

    def answer(connection: Any) -> tuple[list[str], list[tuple[Any, ...]]]:
        with nullcontext() if bounds is None else bounds.timed(connection):
            found = connection.execute(_selects(connection, sql))
            return [one[0] for one in found.description or ()], found.fetchall()

    (columns, rows), lost = _answered(store, answer, {} if bounds is None else bounds.options(), warn)
    return Answer(columns, rows, lost)


def segments_where(store: Store, condition: str) -> tuple[dict[str, set[int]], int]:
    """Offsets of the messages with frames that fit a condition, by segment, and the number of segments whose tables are
    lost, so that theirs are not among them. Raises SettingsError, OSError.
    """

    def answer(connection: Any) -> dict[str, set[int]]:
        found: dict[str, set[int]] = {}
        sql = f'SELECT DISTINCT segment, "offset" FROM frames WHERE ({condition}\n)'
        for segment, offset in connection.execute(_selects(connection, sql)).fetchall():
            found.setdefault(segment, set()).add(offset)
        return found

    return _answered(store, answer)


def _selects(connection: Any, sql: str) -> Any:
    """The one statement of a query, that only reads. Raises SettingsError.

    Others write files, load code, or change what the next one may do, and a condition may bring them along.
    """
    import duckdb

    statements = connection.extract_statements(sql)
    if not statements:
        raise SettingsError("the query is empty", "sql")
    if len(statements) > 1 or statements[0].type != duckdb.StatementType.SELECT:
        raise SettingsError("the query must be a single SELECT", "sql")
    return statements[0]


def _answered(
    store: Store,
    answer: Callable[[Any], Found],
    options: Mapping[str, str | int] = MappingProxyType({}),
    warn: Warn = logger.warning,
) -> tuple[Found, int]:
    """What `answer` makes of a connection, and the number of segments whose tables are lost."""
    tables = tables_to_read(store)
    for _ in range(TRIES - 1):
        try:
            return _asked(store, answer, tables, options, warn)
        except TimeoutError:
            raise
        except (OSError, SourceError) as error:
            before, tables = tables, tables_to_read(store)
            if before == tables:
                tables = tables_to_read(store, joined=False)
                if before == tables:
                    raise
                warn("joined tables were not used; if --job index does not help, delete index/: %s", error)
    return _asked(store, answer, tables, options, warn)


def _asked(
    store: Store, answer: Callable[[Any], Found], tables: Tables, options: Mapping[str, str | int], warn: Warn
) -> tuple[Found, int]:
    with duckdb_errors(), with_tables(store, tables, options, closed=True) as connection:
        found = answer(connection)
    if tables.lost:
        names = ", ".join(tables.lost[:_SHOWN])
        warn("%d segments have lost their tables, so their frames are missing here: %s", len(tables.lost), names)
    return found, len(tables.lost)
