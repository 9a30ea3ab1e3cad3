"""`lidarcodec archive query`: SQL over the index of an archive."""

from __future__ import annotations

import math
from datetime import datetime
from typing import Any

from lidarcodec.archive.archive import open_archive
from lidarcodec.archive.query import query
from lidarcodec.archive.table import check_extra
from lidarcodec.commands.running.telling import tell
from lidarcodec.errors import SourceError
from lidarcodec.units import counted
from lidarcodec.untrusted.text import printable


def run(archive: str, sql: str, as_json: bool) -> None:
    """Print the rows of a query.

    Raises SourceError if tables are lost, so that rows are missing, when the others were printed.
    """
    check_extra("a query")
    names, rows, lost = query(open_archive(archive).store, sql)
    plain = [list(map(_plain, row)) for row in rows]
    table = [[printable(str(value)) for value in row] for row in (names, *plain)]
    widths = [max(len(row[at]) for row in table) for at in range(len(names))]
    lines = ("  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip() for row in table)
    tell({"columns": names, "rows": plain, "lost": lost}, "\n".join(lines), as_json)
    if lost:
        raise SourceError(
            f"the answer lacks {counted(lost, 'segment')} whose tables are lost: `archive run --repair` makes them "
            "again from their inputs"
        )


def _plain(value: Any) -> Any:
    """A value of DuckDB as one that JSON has."""
    if isinstance(value, datetime):
        return value.isoformat()
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if value is None or isinstance(value, bool | int | float | str) else str(value)
