"""The table of frames: a row for each frame of a segment, as Parquet written by DuckDB (extra `archive`).

Equal rows give equal bytes.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import numpy as np

from lidarcodec.archive.stores.base import Store
from lidarcodec.errors import MissingExtraError, SettingsError, SourceError
from lidarcodec.frame import Frame

COLUMNS: Final[Mapping[str, str]] = {
    "vehicle": "VARCHAR",
    "sensor": "VARCHAR",
    "model": "VARCHAR",
    "time": "TIMESTAMP_NS",
    "stamp_ns": "BIGINT",
    "frame": "BIGINT",
    "points": "INTEGER",
    "x": "DOUBLE",
    "y": "DOUBLE",
    "z": "DOUBLE",
    "pose": "DOUBLE[]",
    "min_x": "FLOAT",
    "min_y": "FLOAT",
    "min_z": "FLOAT",
    "max_x": "FLOAT",
    "max_y": "FLOAT",
    "max_z": "FLOAT",
    "packets": "INTEGER",
    "packet_bytes": "BIGINT",
    "bytes": "BIGINT",
    "codec": "VARCHAR",
    "bound_m": "DOUBLE",
    "error_m": "DOUBLE",
    "key": "BOOLEAN",
    "object": "VARCHAR",
    "offset": "BIGINT",
    "length": "BIGINT",
    "checksum": "UINTEGER",
    "segment": "VARCHAR",
}
"""Columns and their types. docs/guides/archive.md explains them."""
_PROTOCOL: Final = "archive"
_OURS: Final = re.compile(r"[\w.]*Error: .")
"""A line of an error that Python code of ours raised below DuckDB."""
_SELECT: Final = ", ".join("make_timestamp_ns(stamp_ns) AS time" if name == "time" else f'"{name}"' for name in COLUMNS)


def check_extra(what: str = "an archive") -> None:
    """Raise MissingExtraError if DuckDB is not installed."""
    if find_spec("duckdb") is None:
        raise MissingExtraError(what, "archive")


def place_of(frame: Frame) -> dict[str, Any]:
    """Columns of a decoded frame: number of points, bounds of its cloud in metres, pose of the sensor."""
    cloud = frame.cloud()
    row: dict[str, Any] = {"points": len(cloud)}
    for axis in "xyz":
        values = cloud[axis][np.isfinite(cloud[axis])]
        row[f"min_{axis}"] = float(values.min()) if len(values) else None
        row[f"max_{axis}"] = float(values.max()) if len(values) else None
    pose = None if frame.pose is None else frame.pose[:3]
    row["pose"] = None if pose is None else [float(value) for value in pose.ravel()]
    for at, axis in enumerate("xyz"):
        row[axis] = None if pose is None else float(pose[at, 3])
    return row


def write_table(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Write rows, each with all columns but `time`, as a Parquet file. Raises OSError if the disk fails."""
    import duckdb

    lines = path.with_suffix(".jsonl")
    lines.write_text("".join(f"{json.dumps(row)}\n" for row in rows))
    types = {name: kind for name, kind in COLUMNS.items() if name != "time"}
    try:
        with duckdb_errors(), duckdb.connect(config={"threads": 1}) as connection:
            connection.execute(
                f"COPY (SELECT {_SELECT} FROM read_json({text_of(lines)}, format = 'newline_delimited', "
                f"columns = {types})) TO {text_of(path)} (FORMAT parquet, COMPRESSION zstd)"
            )
    finally:
        lines.unlink(missing_ok=True)


class QueryMemoryError(SettingsError, MemoryError):
    """A query takes more memory than it may, or than there is. A task that needs one is tried again."""


@contextmanager
def duckdb_errors() -> Iterator[None]:
    """Errors of a query as SettingsError, those of damaged tables as SourceError, those of a store as OSError.

    A query that was interrupted is a TimeoutError, one that lacks memory a QueryMemoryError.
    """
    check_extra()
    import duckdb

    try:
        yield
    except duckdb.IOException as error:
        raise OSError(_line(error)) from None
    except duckdb.InterruptException:
        raise TimeoutError("the query took too long") from None
    except duckdb.OutOfMemoryException as error:
        raise QueryMemoryError(f"the query needs more memory than is allowed: ask for less ({_line(error)})") from None
    except duckdb.InvalidInputException as error:
        raise SourceError(f"the archive has a damaged table: {_line(error)}") from None
    except duckdb.Error as error:
        if type(error) is duckdb.Error:  # our own error while it read the store, as a text with all its calls
            raise OSError(_line(error)) from None
        raise SettingsError(f"the query cannot be run: {_line(error)}", "sql") from None


def _line(error: Exception) -> str:
    """The line of an error that says what happened."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    ours = (line for line in reversed(lines) if _OURS.match(line))
    return next(ours, lines[0] if lines else type(error).__name__)[:500]


class Tables(NamedTuple):
    """Tables of an archive. names: of their objects;  hidden: segments whose rows are not read
    lost: VEHICLE/SENSOR/SEGMENT of those whose tables are not there
    """

    names: list[str]
    hidden: frozenset[str] = frozenset()
    lost: tuple[str, ...] = ()


@contextmanager
def with_tables(
    store: Store, tables: Tables, options: Mapping[str, str | int] = MappingProxyType({}), *, closed: bool = False
) -> Iterator[Any]:
    """A connection of DuckDB in which `frames` is a view of tables of an archive.

    options: of DuckDB;  closed: whether what is asked may read these tables alone: no other file, address or extension
    """
    check_extra("a query")
    import duckdb

    names = tables.names
    fixed = {"autoinstall_known_extensions": False, "python_enable_replacements": False}

    with duckdb.connect(config={**fixed, **options}) as connection:
        if not names:
            columns = ", ".join(f'CAST(NULL AS {kind}) AS "{name}"' for name, kind in COLUMNS.items())
            connection.execute(f"CREATE VIEW frames AS SELECT {columns} LIMIT 0")
            if closed:
                _close(connection, [])
            yield connection
            return
        if store.file(names[0]) is not None:
            paths = [str(store.file(name)) for name in names]
        else:
            from lidarcodec.archive.stores.files import StoreFiles

            connection.register_filesystem(StoreFiles(store))
            paths = [f"{_PROTOCOL}://{name}" for name in names]
        texts = ", ".join(map(text_of, paths))
        shown = f"SELECT * FROM read_parquet([{texts}], hive_partitioning = false)"
        if tables.hidden:
            connection.execute("CREATE TABLE hidden AS SELECT unnest(?) AS id", [sorted(tables.hidden)])
            shown += " WHERE segment NOT IN (SELECT id FROM hidden)"
        connection.execute(f"CREATE VIEW frames AS {shown}")
        if closed:
            _close(connection, paths)
        yield connection


def _close(connection: Any, paths: Sequence[str]) -> None:
    """Let a connection open these files alone, for good."""
    connection.execute(f"SET allowed_paths = [{', '.join(map(text_of, paths))}]")
    connection.execute("SET enable_external_access = false")
    connection.execute("SET lock_configuration = true")


def text_of(path: str | Path) -> str:
    """A path as a text of SQL."""
    escaped = str(path).replace("'", "''")
    return f"'{escaped}'"
