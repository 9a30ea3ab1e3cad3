"""SQL over the table of frames, by DuckDB. Nothing is downloaded but the table: the store is read through obstore."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any, Final, TypeVar

from lidarcodec.archive.index import tables_to_read
from lidarcodec.archive.stores.base import Store
from lidarcodec.archive.table import duckdb_errors, with_tables
from lidarcodec.errors import SourceError

log = logging.getLogger(__name__)

TRIES: Final = 3
"""So often a query is tried when tables were joined or replaced, and then removed, while it ran."""
Answer = TypeVar("Answer")


def query(store: Store, sql: str) -> tuple[list[str], list[tuple[Any, ...]]]:
    """Names of columns and rows of a query over the table `frames`. Raises SettingsError if it is wrong, OSError."""

    def answer(connection: Any) -> tuple[list[str], list[tuple[Any, ...]]]:
        found = connection.execute(sql)
        return [one[0] for one in found.description or ()], found.fetchall()

    return _answered(store, answer)


def segments_where(store: Store, condition: str) -> dict[str, set[int]]:
    """Offsets of the messages with frames that fit a condition, by segment. Raises SettingsError, OSError."""

    def answer(connection: Any) -> dict[str, set[int]]:
        found: dict[str, set[int]] = {}
        rows = connection.execute(f'SELECT DISTINCT segment, "offset" FROM frames WHERE ({condition}\n)').fetchall()
        for segment, offset in rows:
            found.setdefault(segment, set()).add(offset)
        return found

    return _answered(store, answer)


def _answered(store: Store, answer: Callable[[Any], Answer]) -> Answer:
    tables = tables_to_read(store)
    for _ in range(TRIES - 1):
        try:
            with duckdb_errors(), with_tables(store, tables) as connection:
                return answer(connection)
        except (OSError, SourceError) as error:
            before, tables = tables, tables_to_read(store)
            if before == tables:
                tables = tables_to_read(store, joined=False)
                if before == tables:
                    raise
                log.warning("joined tables were not used; if --job index does not help, delete index/: %s", error)
    with duckdb_errors(), with_tables(store, tables) as connection:
        return answer(connection)
