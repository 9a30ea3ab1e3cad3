"""Compares an archive with its store, and removes what was begun and never became visible. No run may be active."""

from __future__ import annotations

from collections import Counter

from lidarcodec.archive.contents import commits_of
from lidarcodec.archive.product import read_commit
from lidarcodec.archive.stores.base import Store
from lidarcodec.errors import SourceError


def repair(store: Store) -> Counter[str]:
    """Remove objects without a commit, commits whose objects are lost, and all notes of what was set aside.

    The next run makes again what was removed, and tries again what was set aside. Returns numbers of removed objects:
    `unfinished`, `lost` (commits), `aside`, `leftovers`.
    """
    counts: Counter[str] = Counter()
    there = {entry.name: entry.size for folder in ("recordings/", "frames/") for entry in store.entries(folder)}
    named: set[str] = set()
    for hidden in (True, False):
        for commit in commits_of(store, hidden=hidden):
            try:
                value = read_commit(store, commit)
                lost = there.get(value["object"]) != value["bytes"] or value["table"] not in there
            except SourceError:
                value, lost = {}, True
            if lost and not hidden:
                store.delete(commit.name)
                counts["lost"] += 1
            elif value:
                named |= {value["object"], value["table"]}
    for name in sorted(there.keys() - named):
        store.delete(name)
        counts["unfinished"] += 1
    for entry in list(store.entries("aside/")):
        store.delete(entry.name)
        counts["aside"] += 1
    for path in list(store.leftovers()):
        path.unlink(missing_ok=True)
        counts["leftovers"] += 1
    return counts
