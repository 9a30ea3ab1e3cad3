"""`lidarcodec archive query`: SQL over the index of an archive."""

from __future__ import annotations

import json
from datetime import datetime
from typing import Any

from lidarcodec.archive.archive import Archive
from lidarcodec.archive.table import check_extra


def run(archive: str, sql: str, as_json: bool) -> None:
    """Print the rows of a query."""
    check_extra("a query")
    names, rows = Archive(archive).query(sql)
    if as_json:
        print(json.dumps([dict(zip(names, map(_plain, row), strict=True)) for row in rows], indent=2))
        return
    table = [names, *([str(_plain(value)) for value in row] for row in rows)]
    widths = [max(len(row[at]) for row in table) for at in range(len(names))]
    for row in table:
        print("  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip())


def _plain(value: Any) -> Any:
    """A value of DuckDB as one that JSON has."""
    if isinstance(value, datetime):
        return value.isoformat()
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    return value if value is None or isinstance(value, bool | int | float | str) else str(value)
