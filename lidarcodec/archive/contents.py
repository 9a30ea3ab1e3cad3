"""What is in an archive, by listings alone: commits, plans, what was set aside, tables of frames."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

from lidarcodec.archive.names import Commit, PlanName, commit_of, json_of, part_segment, plan_of
from lidarcodec.archive.objects import read_commit
from lidarcodec.archive.segments import MAX_SECONDS
from lidarcodec.archive.stores.base import Store

WHOLE: Final = "0" * 24
"""In the place of a segment's id: the whole input was set aside."""
_ASIDE: Final = re.compile(r"aside/(?P<origin>[0-9a-f]{24})-(?P<segment>[0-9a-f]{24})\.json")
_SLACK_NS: Final = int(2 * MAX_SECONDS * 1e9)
"""No segment is longer."""


@dataclass
class Contents:
    """What was done, by id.

    plans: by origin;  committed: segments by origin;  aside: segments by origin
    cut: origins by input, inputs by the id of their name
    """

    plans: dict[str, PlanName] = field(default_factory=dict)
    committed: dict[str, set[str]] = field(default_factory=dict)
    aside: dict[str, set[str]] = field(default_factory=dict)
    cut: dict[str, set[str]] = field(default_factory=dict)

    @classmethod
    def of(cls, store: Store) -> Contents:
        """The contents of an archive: three listings. Raises OSError."""
        found = cls()
        for entry in store.entries("plans/"):
            if (plan := plan_of(entry.name)) is not None:
                found.plans.setdefault(plan.origin, plan)
                found.cut.setdefault(plan.input, set()).add(plan.origin)
                found.cut.setdefault(plan.name, set()).add(plan.input)
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
        return WHOLE in aside or (origin in self.plans and done >= self.plans[origin].segments)

    def others(self, input_id: str, origin: str) -> list[str]:
        """Other settings with which an input is in the archive already, whole or in part: their origins."""
        return sorted(one for one in self.cut.get(input_id, ()) if one != origin and self.committed.get(one))

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

    Of several that replace the same one, as two runs with different settings make them, the one with the smallest id
    counts.

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
    gone = _hidden(found)
    return [one for one in found if (one.segment in gone) == hidden and (not between or one.last_ns >= between[0])]


def _hidden(commits: Sequence[Commit]) -> set[str]:
    """Segments that are not visible: those that were replaced, and all that came from one that does not count."""
    segments = {one.segment for one in commits}
    after: dict[str, set[str]] = {}
    for one in commits:
        if one.origin in segments:  # otherwise it comes from an input
            after.setdefault(one.origin, set()).add(one.segment)
    found = set(after)
    waiting = [segment for those in after.values() for segment in those - {min(those)}]
    seen: set[str] = set()  # damaged names may form a ring
    while waiting:
        if (segment := waiting.pop()) not in seen:
            seen.add(segment)
            waiting.extend(after.get(segment, ()))
    return found | seen


def tables_of(store: Store, commits: Sequence[Commit]) -> tuple[list[str], list[Commit]]:
    """Names of the tables of segments, and the segments whose tables are not there.

    A segment has two tables only where two builds wrote different bytes at the same time; then its commit is read.
    """
    if not commits:
        return [], []
    by_segment: dict[str, list[str]] = {}
    for entry in store.entries("frames/"):
        if (segment := part_segment(entry.name)) is not None:
            by_segment.setdefault(segment, []).append(entry.name)
    found, lost = [], []
    for commit in commits:
        names = by_segment.get(commit.segment, [])
        name = names[0] if len(names) == 1 else read_commit(store, commit)["table"] if names else None
        if name in names:
            found.append(name)
        else:
            lost.append(commit)
    return found, lost
