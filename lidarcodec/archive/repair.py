"""Compares an archive with its store, and removes what was begun and never became visible. No run may be active."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Iterator
from typing import NamedTuple

from lidarcodec.archive.contents import commits_of
from lidarcodec.archive.jobs.reading import made_from
from lidarcodec.archive.names import Commit, segment_of_note
from lidarcodec.archive.objects import read_commit
from lidarcodec.archive.stores.base import Store
from lidarcodec.errors import SourceError

logger = logging.getLogger(__name__)


class _Named(NamedTuple):
    """What a commit names. size: of its recording"""

    object: str
    table: str
    size: int


def repair(store: Store, source: Store) -> Counter[str]:
    """Remove objects without a commit, commits whose recordings are lost, and all notes of what was set aside.

    The next run makes again what was removed, and tries again what was set aside. A commit that cannot be read stays,
    with all objects of its segment: they may be all that is left of the input. So does a recording that has another
    size than it should, or whose table is lost, if its input is not in `source` any more. Returns numbers of removed
    objects: `unfinished`, `lost` (commits), `aside`, `leftovers`.
    """
    counts: Counter[str] = Counter()
    there = {entry.name: entry.size for folder in ("recordings/", "frames/") for entry in store.entries(folder)}
    known: dict[Commit, _Named | None] = {}
    while lost := [one for one in commits_of(store) if _is_lost(store, source, one, _known(store, one, known), there)]:
        for commit in lost:  # what it replaced is visible then, and may be lost, too
            store.delete(commit.name)
            counts["lost"] += 1
        segments = {commit.segment for commit in lost}
        for entry in list(store.entries("verified/")):
            if segment_of_note(entry.name) in segments:
                store.delete(entry.name)
    named = set(_kept(store, there, known))
    joined = {entry.name for entry in store.entries("index/")}
    unlisted = {name for name in joined if name.endswith(".parquet") and f"{name[:-8]}.json" not in joined}
    for name in sorted(unlisted | (there.keys() - named)):
        store.delete(name)
        counts["unfinished"] += 1
    for entry in list(store.entries("aside/")):
        store.delete(entry.name)
        counts["aside"] += 1
    for path in list(store.leftovers()):
        path.unlink(missing_ok=True)
        counts["leftovers"] += 1
    return counts


def _known(store: Store, commit: Commit, known: dict[Commit, _Named | None]) -> _Named | None:
    """What a commit names; None if it cannot be read. Each commit is read once."""
    if commit not in known:
        try:
            value = read_commit(store, commit)
            known[commit] = _Named(value["object"], value["table"], value["bytes"])
        except SourceError as error:
            logger.warning("the description of a segment was left unchanged: %s", error)
            known[commit] = None
    return known[commit]


def _is_lost(store: Store, source: Store, commit: Commit, found: _Named | None, there: dict[str, int]) -> bool:
    """Whether a visible segment is to be made again."""
    if found is None or (there.get(found.object) == found.size and found.table in there):
        return False
    return found.object not in there or made_from(read_commit(store, commit), source) is not None


def _kept(store: Store, there: dict[str, int], known: dict[Commit, _Named | None]) -> Iterator[str]:
    """Names of recordings and tables that stay."""
    for hidden in (True, False):
        for commit in commits_of(store, hidden=hidden):
            found = _known(store, commit, known)
            if found is None:
                yield from (name for name in there if f"/{commit.segment}-" in name)
                continue
            if not hidden and there.get(found.object) != found.size:
                logger.warning("%s is damaged, and its input no longer exists, so it was left unchanged", found.object)
            if not hidden and found.table not in there:
                logger.warning(
                    "the table of %s is lost, and its input no longer exists: queries do not find its frames",
                    found.object,
                )
            yield from (found.object, found.table)
