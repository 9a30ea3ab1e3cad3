"""Joined tables: the rows of many segments in one file, so that a query opens few files.

A joined table `index/ID.parquet` counts once `index/ID.json` names its segments. It is only a copy: the tables of the
segments stay, and each row is read from one of them. Which one is decided by listings alone, so a joined table may be
made or removed by anyone at any time. Rows of segments that were replaced later are left out when it is read.

Tables of about the same size are joined when there are FAN_IN of them. So each row is copied a few times at most, and
the number of files grows slowly with the number of segments.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from typing import Final, NamedTuple

from lidarcodec.archive.contents import commits_of, tables_of
from lidarcodec.archive.names import Commit, id_of, json_of, part_segment
from lidarcodec.archive.objects import read_joined
from lidarcodec.archive.scratch import scratch_folder
from lidarcodec.archive.stores.base import Store
from lidarcodec.archive.table import Tables, duckdb_errors, text_of, with_tables
from lidarcodec.errors import SourceError

logger = logging.getLogger(__name__)

FAN_IN: Final = 16
"""Tables of about the same size that are joined to one."""
LARGEST: Final = FAN_IN**3
"""Most segments of a joined table: two days of a vehicle."""
_TRIES: Final = 3
_ROUNDS: Final = 4
"""So often joined tables are joined again: LARGEST is reached then."""


class _Joined(NamedTuple):
    """A joined table that is in use. visible, hidden: its segments; hidden ones were replaced"""

    id: str
    visible: frozenset[str]
    hidden: frozenset[str]


class _State(NamedTuple):
    """used: joined tables to read;  stale: ids of other ones;  rest: names of tables of segments that are in none
    lost: segments of which no table is there
    """

    used: list[_Joined]
    stale: list[str]
    rest: list[str]
    lost: list[Commit]

    def tables(self) -> Tables:
        names = [_table(one.id) for one in self.used] + self.rest
        lost = tuple(f"{one.vehicle}/{one.sensor}/{one.segment}" for one in self.lost)
        return Tables(names, frozenset(segment for one in self.used for segment in one.hidden), lost)


def tables_to_read(store: Store, *, joined: bool = True) -> Tables:
    """The tables that hold the rows of all visible segments, each row once, and which segments have lost theirs.

    joined: whether joined tables are used
    Raises OSError.
    """
    return _state(store, joined=joined).tables()


def index(store: Store) -> dict[str, int]:
    """Join tables of which there are many, and remove joined ones that are not used any more.

    Returns numbers: `joined` tables, `removed` ones. Raises OSError; then the next call continues.
    """
    counts = {"joined": 0, "removed": 0}
    for name in _unreadable(store):  # first: the same segments may be joined again under the same name
        _remove(store, name)
        counts["removed"] += 1
    for _ in range(_ROUNDS):
        state = _state(store)
        groups = list(_groups(state))
        for group in groups:
            _join(store, group)
        counts["joined"] += len(groups)
        if not groups:
            break
    for name in _state(store).stale:
        _remove(store, name)
        counts["removed"] += 1
    return counts


def _remove(store: Store, name: str) -> None:
    store.delete(f"index/{name}.json")  # first: without it nobody looks for the table
    store.delete(_table(name))


def _unreadable(store: Store) -> list[str]:
    """Ids of joined tables that are damaged, as a look at the end of each shows, which says how many rows it has."""
    found, damaged = _listed(store)
    for ident in found:
        try:
            with duckdb_errors(), with_tables(store, Tables([_table(ident)])) as connection:
                connection.execute("SELECT count(*) FROM frames").fetchall()
        except OSError:
            if store.size(_table(ident)) is not None:  # otherwise it was removed meanwhile
                raise
        except SourceError as error:
            logger.warning("a joined table is damaged and was removed: %s", error)
            damaged.append(ident)
    return damaged


class _Group(NamedTuple):
    """Tables to join. segments: those whose rows are copied"""

    tables: Tables
    segments: list[str]


def _groups(state: _State) -> Iterator[_Group]:
    """Tables that are to be joined: FAN_IN in a group, or fewer that together have LARGEST segments."""
    tiers: dict[int, list[tuple[str, frozenset[str], frozenset[str]]]] = {}
    for name in state.rest:
        tiers.setdefault(0, []).append((name, frozenset((str(part_segment(name)),)), frozenset()))
    for one in state.used:
        tiers.setdefault(_tier(len(one.visible)), []).append((_table(one.id), one.visible, one.hidden))
    for _, members in sorted(tiers.items()):
        group: list[tuple[str, frozenset[str], frozenset[str]]] = []
        for at, member in enumerate(members):
            group.append(member)
            last = at + 1 == len(members)
            whole = last or sum(len(one[1]) for one in (*group, members[at + 1])) > LARGEST
            if whole and len(group) >= (FAN_IN if last else max(2, FAN_IN // 4)):
                hidden = frozenset().union(*(one[2] for one in group))
                yield _Group(Tables([one[0] for one in group], hidden), sorted(set().union(*(one[1] for one in group))))
            if whole:
                group = []


def _tier(segments: int) -> int:
    """0 for 1 to 15 segments, 1 for 16 to 255, and so on."""
    tier = 0
    while segments >= FAN_IN:
        segments, tier = segments // FAN_IN, tier + 1
    return tier


def _join(store: Store, group: _Group) -> None:
    ident = id_of("index", group.segments)
    with scratch_folder() as folder, duckdb_errors(), with_tables(store, group.tables) as connection:
        path = folder / "joined.parquet"
        connection.execute("SET threads = 1")  # so that equal rows give equal bytes
        connection.execute(
            f"COPY (SELECT * FROM frames ORDER BY vehicle, sensor, stamp_ns, frame, segment) TO {text_of(path)} "
            "(FORMAT parquet, COMPRESSION zstd)"
        )
        size = path.stat().st_size
        if not store.create(_table(ident), path) and store.size(_table(ident)) != size:
            store.delete(_table(ident))  # cut, or of another version of DuckDB
            store.create(_table(ident), path)
    store.create(f"index/{ident}.json", json_of({"segments": group.segments, "bytes": size}))


def _table(ident: str) -> str:
    return f"index/{ident}.parquet"


def _state(store: Store, *, joined: bool = True) -> _State:
    commits = commits_of(store)
    for _ in range(_TRIES):
        found = _state_of(store, commits, joined=joined)
        if not found.lost or set(found.lost) <= set(commits := commits_of(store)):
            break  # otherwise some were replaced meanwhile, and then deleted
    return found


def _state_of(store: Store, commits: list[Commit], *, joined: bool) -> _State:
    found, damaged = _listed(store) if joined else ({}, [])
    left = {commit.segment for commit in commits}
    used: list[_Joined] = []
    for ident, segments in sorted(found.items(), key=lambda one: (-len(one[1]), one[0])):
        visible = segments & left
        hidden = segments - visible
        if len(visible) > len(hidden) and not any(one.visible & hidden for one in used):  # no row may be in two tables
            used.append(_Joined(ident, visible, hidden))
            left -= visible
    stale = [ident for ident in (*found, *damaged) if ident not in {one.id for one in used}]
    return _State(used, stale, *tables_of(store, [one for one in commits if one.segment in left]))


def _listed(store: Store) -> tuple[dict[str, frozenset[str]], list[str]]:
    """Segments of each joined table by its id, and ids of those that are damaged."""
    names = {entry.name.removeprefix("index/"): entry.size for entry in store.entries("index/")}
    found: dict[str, frozenset[str]] = {}
    damaged: list[str] = []
    for ident in sorted(name.removesuffix(".json") for name in names if name.endswith(".json")):
        if f"{ident}.parquet" not in names:
            damaged.append(ident)
            continue
        try:
            found[ident] = frozenset(read_joined(store, f"index/{ident}.json", names[f"{ident}.parquet"]))
        except FileNotFoundError:  # removed meanwhile
            continue
        except SourceError as error:
            logger.warning("a joined table is damaged and is not used: %s", error)
            damaged.append(ident)
    return found, damaged
