"""Finding: segments of an archive by its index, and the commit of one segment. Blocks: call it from threads."""

from __future__ import annotations

import logging
import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

from lidarcodec.archive.archive import Archive
from lidarcodec.archive.names import Commit, commit_of, is_id
from lidarcodec.archive.objects import read_commit
from lidarcodec.archive.query import Bounds, Warn, query
from lidarcodec.archive.table import QueryMemoryError, text_of
from lidarcodec.errors import SettingsError, SourceError
from lidarcodec_server.archived.errors import NoSegmentError

logger = logging.getLogger(__name__)

BOUNDS: Final = Bounds(10.0, 512)
"""What a query may take."""
_AFTER: Final = re.compile(r"(-?\d{1,19})-([0-9a-f]{24})", re.ASCII)
_TEXT: Final = "left(min(CAST({0} AS VARCHAR)), 64)"


@dataclass(frozen=True)
class Wanted:
    """Which segments. Times in ns since the Unix epoch; x, y, radius in metres, as poses of the archive.

    after: `next` of an earlier answer;  a value that is None does not choose
    """

    vehicle: str | None = None
    sensor: str | None = None
    from_ns: int | None = None
    to_ns: int | None = None
    around: tuple[float, float] | None = None
    radius: float = 100.0
    limit: int = 50
    after: str | None = None


class Found(NamedTuple):
    """A segment, as the index has it. bound_m is None where a coding has no bound"""

    segment: str
    vehicle: str
    sensor: str
    begin_ns: int
    end_ns: int
    frames: int
    bytes: int
    codec: str
    bound_m: float | None
    object: str


def place_of(text: str) -> tuple[float, float]:
    """The place X,Y. Raises SettingsError.

    >>> place_of("12.5,-3")
    (12.5, -3.0)
    """
    try:
        x, y = map(float, text.split(","))
    except ValueError:
        x = y = math.nan
    if not (abs(x) <= 1e8 and abs(y) <= 1e8):
        raise SettingsError(f"'{text[:64]}' is not a place: write X,Y in metres, for example 120,-35.5", "around")
    return x, y


class Page(NamedTuple):
    """Segments, the newest first. next: `after` for the next ones; None if these are the last
    lost: number of segments of the archive whose tables are lost, so that no search finds them
    """

    segments: list[Found]
    next: str | None
    lost: int


def find(archive: Archive, wanted: Wanted, warn: Warn = logger.warning) -> Page:
    """Search the index. warn: called for lost tables, with the names of their segments

    Raises SettingsError, also for a search that takes too much memory, SourceError for a damaged index, OSError, of
    these TimeoutError.
    """
    sql = _sql(wanted)
    _check_there(archive)
    try:
        _, rows, lost = query(archive.store, sql, BOUNDS, warn)
    except QueryMemoryError:
        raise SettingsError(
            "the search takes too much memory: ask for less, such as one vehicle, a shorter time or a smaller radius"
        ) from None
    except SettingsError as error:  # the query is ours: types in the tables are wrong
        raise SourceError(str(error)) from None
    if any(value is None for row in rows for value in (*row[:8], row[9])) or not all(is_id(row[0]) for row in rows):
        raise SourceError("the archive has a damaged table: a value is missing, or an id is not valid")
    found = [Found._make(row) for row in rows]
    shown = found[: wanted.limit]
    more = len(found) > len(shown)
    return Page(shown, f"{shown[-1].begin_ns}-{shown[-1].segment}" if more else None, lost)


def _sql(wanted: Wanted) -> str:
    names = (("vehicle", wanted.vehicle), ("sensor", wanted.sensor))
    where = [f"{column} = {text_of(name)}" for column, name in names if name is not None]
    having = []
    if wanted.from_ns is not None:
        having.append(f"max(stamp_ns) >= {int(wanted.from_ns)}")
    if wanted.to_ns is not None:
        having.append(f"min(stamp_ns) <= {int(wanted.to_ns)}")
    if wanted.around is not None:
        x, y = wanted.around
        square = f"(x - {x!r}) * (x - {x!r}) + (y - {y!r}) * (y - {y!r})"
        having.append(f"min({square}) <= {wanted.radius * wanted.radius!r}")
    if wanted.after is not None:
        at = _AFTER.fullmatch(wanted.after)
        if at is None:
            raise SettingsError("'after' is not valid: give the `next` of an earlier answer", "after")
        having.append(f"(min(stamp_ns), segment) < ({int(at[1])}, {text_of(at[2])})")
    return (
        f"SELECT segment, {_TEXT.format('vehicle')}, {_TEXT.format('sensor')}, "
        "CAST(min(stamp_ns) AS BIGINT), CAST(max(stamp_ns) AS BIGINT), count(*), CAST(sum(bytes) AS BIGINT), "
        f"{_TEXT.format('codec')}, CAST(CASE WHEN count(bound_m) = count(*) THEN max(bound_m) END AS DOUBLE), "
        "left(min(CAST(object AS VARCHAR)), 1024) FROM (SELECT * REPLACE (CAST(segment AS VARCHAR) AS segment) "
        f"FROM frames{' WHERE ' if where else ''}{' AND '.join(where)}) GROUP BY segment"
        f"{' HAVING ' if having else ''}{' AND '.join(having)} "
        f"ORDER BY min(stamp_ns) DESC, segment DESC LIMIT {int(wanted.limit) + 1}"
    )


class Known(NamedTuple):
    """A segment by its commit. value: contents of the commit"""

    commit: Commit
    value: dict[str, Any]


def segment_of(archive: Archive, segment: str, stopped: Callable[[], bool]) -> Known:
    """The commit of a segment. stopped: whether to give up

    Raises NoSegmentError, SourceError for a damaged commit, OSError, of these TimeoutError if it was stopped.
    """
    _check_there(archive)
    if is_id(segment):
        for entry in archive.store.entries("commits/"):
            if stopped():
                raise TimeoutError("the search for the segment took too long")
            commit = commit_of(entry.name)
            if commit is not None and commit.segment == segment:
                return Known(commit, read_commit(archive.store, commit))
    raise NoSegmentError(f"the archive has no segment '{segment[:64]}': GET /api/v1/archive lists them")


def _check_there(archive: Archive) -> None:
    """Raise OSError if the archive is a folder that is not there: it may be a disk that is away, and no empty one."""
    url = archive.store.url
    if "://" not in url and not Path(url).is_dir():
        raise OSError(f"there is no folder {url}")
