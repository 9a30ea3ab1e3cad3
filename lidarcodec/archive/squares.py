"""The plan of the job `map`: a task for each square of the ground in which an archive has frames with poses.

Poses of all vehicles must be in one frame, as those of a survey or of UTM are.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Final

from lidarcodec.archive.contents import commits_of
from lidarcodec.archive.names import id_of
from lidarcodec.archive.query import query
from lidarcodec.archive.stores.base import Store
from lidarcodec.archive.tasks import Ended, Task

SQUARE_M: Final = 400
"""Side of a square: a multiple of a map's tiles."""
REACH_M: Final = 60
"""Scans from so far outside a square are used for it."""
MAX_SQUARES: Final = 100_000
"""Most squares of a run."""

_SQL: Final = f"""
    with seen as (
        select distinct segment, cast(floor((x + dx) / {SQUARE_M}) as bigint) as col,
               cast(floor((y + dy) / {SQUARE_M}) as bigint) as line
        from frames, unnest([-{REACH_M}, 0, {REACH_M}]) a(dx), unnest([-{REACH_M}, 0, {REACH_M}]) b(dy)
        where isfinite(x) and isfinite(y) and abs(x) < 1e8 and abs(y) < 1e8)
    select col, line, list(segment order by segment) from seen group by col, line order by col, line
    limit {{}}
"""


class MapPlan:
    """Squares that are not in `target` yet.

    counts: `inputs`, which are squares here; of these `finished`, and `unfinished`, which are left for another run;
        `lost` segments without a table, which are in no map
    A map is named by what it is made of: when segments are added or replaced, its square is made again.
    """

    def __init__(self, source: Store, target: Store) -> None:
        self._source, self._target = source, target
        self.counts: Counter[str] = Counter()
        self._changed = self._more = 0

    def tasks(self) -> Iterator[Task]:
        """A task for each square."""
        done = {entry.name for entry in self._target.entries("maps/")}
        _, squares, self.counts["lost"] = query(self._source, _SQL.format(MAX_SQUARES + 1))
        commits = {commit.segment: commit for commit in commits_of(self._source)}
        self._changed, self._more = 0, max(0, len(squares) - MAX_SQUARES)
        for col, line, segments in squares[:MAX_SQUARES]:
            self.counts["inputs"] += 1
            name = f"maps/{col}_{line}-{id_of('map', col, line, segments)}"
            if {f"{name}.lcmap", f"{name}.empty"} & done:
                self.counts["finished"] += 1
                continue
            if not commits.keys() >= set(segments):  # replaced since the query: without them the map had gaps
                self._changed += 1
                continue
            drives = [list(commits[segment]) for segment in segments]
            value = {"name": name, "square": [col, line, SQUARE_M], "commits": drives}
            yield Task("map", name, f"the square at {col * SQUARE_M} m, {line * SQUARE_M} m", self._source.url,
                       self._target.url, value)  # fmt: skip
        self.counts["unfinished"] = self._changed + self._more

    def after(self, ended: Ended) -> Iterator[Task]:
        """None: a square is one task."""
        del ended
        return iter(())

    def remarks(self) -> list[str]:
        """What a person should know, a line each."""
        found = []
        if self._changed:
            found.append(f"{self._changed:,} of the squares changed while they were listed: run again to map them")
        if self._more:
            found.append(f"there are more than {MAX_SQUARES:,} squares: only the first ones, from the west, are mapped")
        return found
