"""What is in an archive, by listings alone: commits, plans, what was set aside, tables of frames."""

from __future__ import annotations

import re
from collections.abc import Set
from dataclasses import dataclass, field
from typing import Final

from lidarcodec.archive.names import Commit, commit_of, json_of, part_segment, plan_of
from lidarcodec.archive.product import read_commit
from lidarcodec.archive.segments import MAX_SECONDS
from lidarcodec.archive.stores.base import Store

WHOLE: Final = "0" * 24
"""In the place of a segment's id: the whole input was set aside."""
_ASIDE: Final = re.compile(r"aside/(?P<origin>[0-9a-f]{24})-(?P<segment>[0-9a-f]{24})\.json")
_SLACK_NS: Final = int(2 * MAX_SECONDS * 1e9)
"""No segment is longer."""


@dataclass
class Contents:
    """counts: segments of each input's plan;  committed: ids of segments by origin;  aside: (origin, segment)"""

    counts: dict[str, int] = field(default_factory=dict)
    committed: dict[str, set[str]] = field(default_factory=dict)
    aside: dict[str, set[str]] = field(default_factory=dict)

    @classmethod
    def of(cls, store: Store) -> Contents:
        """The contents of an archive: three listings. Raises OSError."""
        found = cls()
        for entry in store.entries("plans/"):
            if (plan := plan_of(entry.name)) is not None:
                found.counts.setdefault(*plan)
        for entry in store.entries("commits/"):
            if (commit := commit_of(entry.name)) is not None:
                found.committed.setdefault(commit.origin, set()).add(commit.segment)
        for entry in store.entries("aside/"):
            if (match := _ASIDE.fullmatch(entry.name)) is not None:
                found.aside.setdefault(match["origin"], set()).add(match["segment"])
        return found

    def finished(self, origin: str) -> bool:
        """Whether nothing of an input is left to do."""
        aside = self.aside.get(origin, set())
        done = len(self.committed.get(origin, set()) | (aside - {WHOLE}))
        return WHOLE in aside or done >= self.counts.get(origin, 1 << 62)

    def has(self, origin: str, segment: str) -> bool:
        """Whether a segment is in the archive, or was set aside."""
        return segment in self.committed.get(origin, ()) or segment in self.aside.get(origin, ())


def set_aside(store: Store, origin: str, segment: str, what: str, why: str) -> None:
    """Note that an input (`segment` is WHOLE) or a segment is not worked on any more. what: name of the input"""
    store.create(f"aside/{origin}-{segment}.json", json_of({"what": what, "why": why}))


def commits_of(
    store: Store,
    vehicle: str | None = None,
    sensor: str | None = None,
    between: tuple[int, int] | None = None,
    *,
    hidden: bool = False,
) -> list[Commit]:
    """Visible segments, in order of vehicle, sensor and time. A segment that another one replaces is not visible.

    between: first and last time in ns; with vehicle and sensor only that part of the listing is read
    hidden: whether to give the replaced segments instead
    """
    prefix = "commits/" + (f"{vehicle}/" if vehicle else "") + (f"{sensor}/" if vehicle and sensor else "")
    after = ""
    if between and vehicle and sensor:
        after = f"{prefix}{max(0, between[0] - _SLACK_NS):020}"
    found: list[Commit] = []
    for entry in store.entries(prefix, after):
        commit = commit_of(entry.name)
        if commit is None or sensor not in (None, commit.sensor):
            continue
        if between and commit.first_ns > between[1]:
            if vehicle and sensor:
                break
            continue
        found.append(commit)
    replaced = {one.origin for one in found}
    return [one for one in found if (one.segment in replaced) == hidden and (not between or one.last_ns >= between[0])]


def tables_of(store: Store, leave_out: Set[str] = frozenset()) -> list[str]:
    """Names of the tables of all visible segments. leave_out: ids of segments that are not needed

    A segment has two tables only where two builds wrote different bytes at the same time; then its commit is read.
    """
    commits = [commit for commit in commits_of(store) if commit.segment not in leave_out]
    if not commits:
        return []
    by_segment: dict[str, list[str]] = {}
    for entry in store.entries("frames/"):
        if (segment := part_segment(entry.name)) is not None:
            by_segment.setdefault(segment, []).append(entry.name)
    found = []
    for commit in commits:
        names = by_segment.get(commit.segment, [])
        found.append(names[0] if len(names) == 1 else read_commit(store, commit)["table"])
    return found
