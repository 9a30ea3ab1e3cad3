"""SQL over the table of frames, by DuckDB. Nothing is downloaded but the table: the store is read through obstore."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

from lidarcodec.archive.contents import tables_of
from lidarcodec.archive.stores.base import Store
from lidarcodec.archive.table import COLUMNS, check_extra
from lidarcodec.errors import SettingsError

_PROTOCOL: Final = "archive"


def query(store: Store, sql: str) -> tuple[list[str], list[tuple[Any, ...]]]:
    """Names of columns and rows of a query over the table `frames`. Raises SettingsError if it is wrong, OSError."""
    with _connected(store) as connection, _wrong(sql):
        found = connection.execute(sql)
        names = [one[0] for one in found.description or ()]
        return names, found.fetchall()


def segments_where(store: Store, condition: str) -> dict[str, set[int]]:
    """Offsets of the messages with frames that fit a condition, by segment. Raises SettingsError, OSError."""
    found: dict[str, set[int]] = {}
    with _connected(store) as connection, _wrong(condition):
        for segment, offset in connection.execute(
            f'SELECT DISTINCT segment, "offset" FROM frames WHERE ({condition}\n)'
        ).fetchall():
            found.setdefault(segment, set()).add(offset)
    return found


@contextmanager
def _connected(store: Store) -> Iterator[Any]:
    """A connection in which `frames` is a view of all tables of an archive."""
    check_extra("a query")
    import duckdb

    names = tables_of(store)
    with duckdb.connect(config={"autoinstall_known_extensions": False}) as connection:
        if not names:
            columns = ", ".join(f'CAST(NULL AS {kind}) AS "{name}"' for name, kind in COLUMNS.items())
            connection.execute(f"CREATE VIEW frames AS SELECT {columns} LIMIT 0")
            yield connection
            return
        if store.file(names[0]) is not None:
            paths = [str(store.file(name)) for name in names]
        else:
            from lidarcodec.archive.stores.files import StoreFiles

            connection.register_filesystem(StoreFiles(store))
            paths = [f"{_PROTOCOL}://{name}" for name in names]
        texts = ", ".join("'" + path.replace("'", "''") + "'" for path in paths)
        connection.execute(f"CREATE VIEW frames AS SELECT * FROM read_parquet([{texts}], hive_partitioning = false)")
        yield connection


@contextmanager
def _wrong(sql: str) -> Iterator[None]:
    """Errors of a query as SettingsError."""
    import duckdb

    try:
        yield
    except duckdb.IOException as error:
        raise OSError(str(error).splitlines()[0]) from None
    except duckdb.Error as error:
        raise SettingsError(f"the query cannot be run: {str(error).splitlines()[0]}", "sql") from None
