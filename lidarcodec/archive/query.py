"""SQL over the table of frames, by DuckDB. Nothing is downloaded but the table: the store is read through obstore."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from lidarcodec.archive.index import tables_to_read
from lidarcodec.archive.stores.base import Store
from lidarcodec.archive.table import check_extra, with_tables
from lidarcodec.errors import SettingsError, SourceError


def query(store: Store, sql: str) -> tuple[list[str], list[tuple[Any, ...]]]:
    """Names of columns and rows of a query over the table `frames`. Raises SettingsError if it is wrong, OSError."""
    with _wrong(), with_tables(store, tables_to_read(store)) as connection:
        found = connection.execute(sql)
        names = [one[0] for one in found.description or ()]
        return names, found.fetchall()


def segments_where(store: Store, condition: str) -> dict[str, set[int]]:
    """Offsets of the messages with frames that fit a condition, by segment. Raises SettingsError, OSError."""
    found: dict[str, set[int]] = {}
    with _wrong(), with_tables(store, tables_to_read(store)) as connection:
        for segment, offset in connection.execute(
            f'SELECT DISTINCT segment, "offset" FROM frames WHERE ({condition}\n)'
        ).fetchall():
            found.setdefault(segment, set()).add(offset)
    return found


@contextmanager
def _wrong() -> Iterator[None]:
    """Errors of a query as SettingsError, those of damaged tables as SourceError."""
    check_extra()
    import duckdb

    try:
        yield
    except duckdb.IOException as error:
        raise OSError(str(error).splitlines()[0]) from None
    except duckdb.InvalidInputException as error:
        raise SourceError(f"the archive has a damaged table: {str(error).splitlines()[0]}") from None
    except duckdb.Error as error:
        raise SettingsError(f"the query cannot be run: {str(error).splitlines()[0]}", "sql") from None
