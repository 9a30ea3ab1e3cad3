"""Compares an archive with its store, and removes what was begun and never became visible. No run may be active."""

from __future__ import annotations

import logging
from collections import Counter

from lidarcodec.archive.contents import commits_of
from lidarcodec.archive.jobs.reading import made_from
from lidarcodec.archive.objects import read_commit
from lidarcodec.archive.stores.base import Store
from lidarcodec.errors import SourceError

log = logging.getLogger(__name__)


def repair(store: Store, source: Store) -> Counter[str]:
    """Remove objects without a commit, commits whose recordings are lost, and all notes of what was set aside.

    The next run makes again what was removed, and tries again what was set aside. A commit that cannot be read stays,
    with all objects of its segment: they may be all that is left of the input. So does a recording whose table is lost
    and whose input is not in `source` any more. Returns numbers of removed objects:
    `unfinished`, `lost` (commits), `aside`, `leftovers`.
    """
    counts: Counter[str] = Counter()
    there = {entry.name: entry.size for folder in ("recordings/", "frames/") for entry in store.entries(folder)}
    named: set[str] = set()
    for hidden in (True, False):
        for commit in commits_of(store, hidden=hidden):
            try:
                value = read_commit(store, commit)
            except SourceError as error:
                log.warning("a commit was left as it is: %s", error)
                named |= {name for name in there if f"/{commit.segment}-" in name}
                continue
            lost, tableless = there.get(value["object"]) != value["bytes"], value["table"] not in there
            if not hidden and (lost or (tableless and made_from(value, source) is not None)):
                store.delete(commit.name)
                counts["lost"] += 1
                continue
            if tableless and not hidden:
                log.warning("the table of %s is lost, and its input, too: queries miss its frames", value["object"])
            named |= {value["object"], value["table"]}
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
