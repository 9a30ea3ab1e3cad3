"""The job `index`: joins the tables of many segments to few, so that a query opens few files.

A joined table `index/ID.parquet` counts once `index/ID.json` names its segments. If one of these is replaced later, the
joined table is not used any more, and the next run of the job removes it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

from lidarcodec.archive.contents import commits_of, tables_of
from lidarcodec.archive.names import id_of, json_of, part_segment
from lidarcodec.archive.scratch import scratch_folder
from lidarcodec.archive.stores.base import Store
from lidarcodec.archive.table import text_of, with_tables
from lidarcodec.untrusted.json import read_json

JOINED: Final = 2000
"""Most segments of a joined table: a day of a vehicle."""
FEWEST: Final = 16
"""Fewer segments are not joined: they would soon be joined again."""
_MAX_NAMES: Final = 1 << 20


def index(store: Store) -> dict[str, int]:
    """Join tables, and remove joined ones that are not used any more. Returns numbers: `joined` tables, their
    `segments`, `removed`."""
    used, stale = _joined(store)
    counts = {"joined": 0, "segments": 0, "removed": len(stale)}
    for name in stale:
        store.delete(f"index/{name}.json")
        store.delete(f"index/{name}.parquet")
    covered = {segment for segments in used.values() for segment in segments}
    rest = [name for name in tables_of(store) if part_segment(name) not in covered]
    for at in range(0, len(rest), JOINED):
        names = rest[at : at + JOINED]
        if len(names) < FEWEST:
            continue
        segments = [str(part_segment(name)) for name in names]
        ident = id_of("index", segments)
        with scratch_folder() as folder, with_tables(store, names) as connection:
            path = folder / "joined.parquet"
            connection.execute("SET threads = 1")
            connection.execute(
                f"COPY (SELECT * FROM frames ORDER BY vehicle, sensor, stamp_ns, frame) TO {text_of(path)} "
                "(FORMAT parquet, COMPRESSION zstd)"
            )
            store.create(f"index/{ident}.parquet", path)
        store.create(f"index/{ident}.json", json_of({"segments": segments}))
        counts["joined"] += 1
        counts["segments"] += len(segments)
    return counts


def tables_to_read(store: Store) -> list[str]:
    """Names of the tables that hold the rows of all visible segments, each row once: joined tables first."""
    used, _ = _joined(store)
    covered = {segment for segments in used.values() for segment in segments}
    joined = [f"index/{name}.parquet" for name in used]
    return joined + tables_of(store, leave_out=covered)


def _joined(store: Store) -> tuple[dict[str, list[str]], list[str]]:
    """Segments of each joined table that is in use, by its id, and ids of those that are not."""
    found = dict(_told(store))
    if not found:
        return {}, []
    visible = {commit.segment for commit in commits_of(store)}
    used: dict[str, list[str]] = {}
    for name, segments in sorted(found.items(), key=lambda one: (-len(one[1]), one[0])):
        if visible.issuperset(segments):
            used[name] = segments
            visible.difference_update(segments)  # no row may be in two tables
    return used, [name for name in found if name not in used]


def _told(store: Store) -> Iterator[tuple[str, list[Any]]]:
    for entry in store.entries("index/"):
        name = entry.name.removeprefix("index/")
        if name.endswith(".json"):
            yield name.removesuffix(".json"), list(read_json(store.read(entry.name), _MAX_NAMES)["segments"])
