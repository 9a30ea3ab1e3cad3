"""What is to be done: the inputs of a store, less what the archive has."""

from __future__ import annotations

import json
import logging
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import asdict
from typing import Any, Final

from lidarcodec.archive.contents import WHOLE, Contents, commits_of
from lidarcodec.archive.inputs import Input, inputs_of
from lidarcodec.archive.names import Commit, id_of
from lidarcodec.archive.objects import read_plan
from lidarcodec.archive.segments import Segment
from lidarcodec.archive.stores.base import Store
from lidarcodec.archive.tasks import Ended, Task
from lidarcodec.errors import SettingsError, SourceError
from lidarcodec.settings import StreamSettings
from lidarcodec.untrusted.text import printable
from lidarcodec.wire.header import MAJOR, MINOR

logger = logging.getLogger(__name__)

ALONE: Final = frozenset({"raw", "zstd", "pcodec", "png", "jxl", "jpeg"})
"""Codecs whose frames need no other frame."""
SHOWN: Final = 20
"""Inputs that are named, of those that are in the archive only in part."""


def archive_settings(settings: StreamSettings) -> StreamSettings:
    """Settings for an archive: with such a codec every message is a key message, unless the interval was chosen.

    A frame then is one read.

    Raises SettingsError for two layers: an archive finds frames by their messages alone.
    """
    if settings.base_error_m is not None:
        raise SettingsError("an archive cannot hold refinements: leave out base_error_m", "base_error_m")
    if settings.codec not in ALONE or "key_interval" in settings.model_fields_set:
        return settings
    return settings.model_copy(update={"key_interval": 1})


class CompressPlan:
    """The job `compress`: inputs are cut into segments, segments are encoded.

    keep_both: whether inputs that are in the archive with other settings are encoded again
    counts: `inputs` so far; of these `finished` with nothing left to do, `other_settings` that are in the archive with
        other settings, `unfinished` (of these, only in part), `changed` since they were archived, and `earlier_aside`,
        of which all or a part was set aside by an earlier run
    """

    def __init__(
        self, source: Store, target: Store, settings: StreamSettings, seconds: float, *, keep_both: bool = False
    ) -> None:
        self._source, self._target, self._seconds = source, target, seconds
        self._settings = settings.model_dump(mode="json")
        self._keep_both = keep_both
        self.counts: Counter[str] = Counter()
        self._contents = Contents()
        self._other = ""
        self._lacking: list[str] = []

    def tasks(self) -> Iterator[Task]:
        """Tasks to begin with."""
        contents = self._contents = Contents.of(self._target)
        for one in inputs_of(self._source.entries()):
            self.counts["inputs"] += 1
            origin = one.id(self._settings, self._seconds, [MAJOR, MINOR])
            self.counts["earlier_aside"] += origin in contents.aside
            if contents.finished(origin):
                self.counts["finished"] += 1
                continue
            if origin not in contents.plans and not self._keep_both and self._is_there(one, origin):
                continue
            value = {"input": asdict(one), "origin": origin, "name": one.name, "settings": self._settings}
            task = self._task(
                "cut", f"{origin}-{WHOLE}", printable(one.name)[:1000], value | {"seconds": self._seconds}
            )
            plan = self._read(origin)
            if plan is None:
                self.counts["changed"] += bool(contents.cut.get(one.name_id(), set()) - {one.id()})
                yield task
            else:
                yield from self._segments(task, plan)

    def after(self, ended: Ended) -> Iterator[Task]:
        """Tasks that follow from one that was done."""
        if ended.task.kind == "cut":
            yield from self._segments(ended.task, ended.result)

    def remarks(self) -> list[str]:
        """What a person should know, a line each."""
        found = []
        if number := self.counts["other_settings"]:
            found.append(
                f"{number:,} of the inputs {_was(number)} in the archive already, with other settings "
                f"({self._other}): --job recompress replaces them, --keep-both adds them once more"
            )
        if number := self.counts["unfinished"]:
            found.append(f"{number:,} of these {_was(number)} there only in part: the earlier settings complete them")
        if number := self.counts["earlier_aside"]:
            found.append(
                f"{number:,} of the inputs {_was(number)} set aside by an earlier run, whole or in part: aside/ in the "
                "archive says why, --repair tries them again"
            )
        if number := self.counts["changed"]:
            found.append(
                f"{number:,} of the inputs, or files beside them, changed since they were archived: the frames of the "
                "earlier ones stay"
            )
        found += self._lacking[:SHOWN]
        if (more := len(self._lacking) - SHOWN) > 0:
            found.append(
                f"{more:,} more of the inputs are not wholly in the archive: `not_kept` of their commits says why"
            )
        return found

    def _is_there(self, one: Input, origin: str) -> bool:
        """Whether an input is in the archive with other settings."""
        others = self._contents.others(one.id(), origin)
        if not others:
            return False
        self.counts["other_settings"] += 1
        self.counts["unfinished"] += not any(map(self._contents.finished, others))
        plan = self._read(others[0]) if not self._other else None
        if plan is not None:
            self._other = _difference(plan | {"version": [MAJOR, MINOR]}, self._settings, self._seconds)
        return True

    def _read(self, origin: str) -> dict[str, Any] | None:
        """The plan of an origin; None if there is none that can be read."""
        if origin not in self._contents.plans:
            return None
        try:
            return read_plan(self._target, self._contents.plans[origin].object)
        except SourceError as error:
            logger.warning("the input is divided into segments again: %s", error)
            return None

    def _segments(self, cutting: Task, plan: dict[str, Any]) -> Iterator[Task]:
        origin = cutting.value["origin"]
        if plan["lost"] is not None:
            self._lacking.append(f"{cutting.label}: not all of it is in the archive: {plan['lost']}")
        value = {name: cutting.value[name] for name in ("input", "name", "origin", "settings")}
        value |= {name: plan[name] for name in ("vehicle", "sensor", "not_kept")}
        for number, one in enumerate(plan["segments"]):
            fields = Segment.of(one).plain()
            segment = id_of("segment", origin, fields)
            if not self._contents.has(origin, segment):
                label = f"{cutting.label}, segment {number + 1} of {len(plan['segments'])}"
                more = {"segment": segment, "range": fields}
                yield self._task("compress", f"{origin}-{segment}", label, value | more)

    def _task(self, kind: str, key: str, label: str, value: dict[str, Any]) -> Task:
        return Task(kind, key, label, self._source.url, self._target.url, value)


def _was(number: int) -> str:
    return "was" if number == 1 else "were"


def _difference(plan: dict[str, Any], settings: dict[str, Any], seconds: float) -> str:
    """What is different in the settings of an earlier plan."""
    earlier = plan.get("settings")
    values = earlier if isinstance(earlier, dict) else {}
    names = [name for name in sorted(settings.keys() | values.keys()) if values.get(name) != settings.get(name)]
    found = [f"{name}={_written(values.get(name))}" for name in names]
    if plan.get("seconds") != seconds:
        found.append(f"--seconds {plan.get('seconds')}")
    return ", ".join(found)[:300] or "another version of the format"


def _written(value: Any) -> str:
    """A value of a setting as `--set` takes it."""
    return value if isinstance(value, str) else json.dumps(value)


Choice = Callable[[Commit], dict[str, Any] | None]
"""Further values for the task of a segment; None: it has none."""


class SegmentPlan:
    """A job on what is in an archive: one task for each visible segment that has not had it.

    kind: the job;  archive: where the segments are: `source` or `target`;  choice: which of them
    done: names in `target` of segments that had it;  clears: whether older recordings that a segment replaced are
        looked for, so that they can be deleted
    counts: `inputs`, which are segments here; `finished` of these
    """

    def __init__(
        self,
        kind: str,
        source: Store,
        target: Store,
        choice: Choice,
        *,
        archive: Store | None = None,
        done: Callable[[], Callable[[Commit], bool]] = lambda: lambda _: False,
        clears: bool = False,
    ) -> None:
        self._kind, self._source, self._target, self._choice = kind, source, target, choice
        self._archive = archive or target
        self._done, self._clears = done, clears
        self.counts: Counter[str] = Counter()

    def tasks(self) -> Iterator[Task]:
        """A task for each segment."""
        is_done = self._done()
        commits = commits_of(self._archive)
        older = self._replaced(commits) if self._clears else {}
        for commit in commits:
            self.counts["inputs"] += 1
            more = None if is_done(commit) else self._choice(commit)
            if more is None:
                self.counts["finished"] += 1
                continue
            label = f"{commit.vehicle}/{commit.sensor}, segment {commit.segment[:8]}"
            value = {"commit": list(commit), "name": commit.name} | more
            if commit in older:
                value["older"] = [list(one) for one in older[commit]]
            key = f"{commit.origin}-{commit.segment}"
            yield Task(self._kind, key, label, self._source.url, self._target.url, value)

    def _replaced(self, visible: list[Commit]) -> dict[Commit, list[Commit]]:
        """By visible segment the segments before it whose recordings are still there."""
        there = {entry.name.rpartition("/")[2].partition("-")[0] for entry in self._archive.entries("recordings/")}
        hidden = commits_of(self._archive, hidden=True)
        before = {one.segment: one.origin for one in (*hidden, *visible)}

        def first(segment: str) -> str:
            """The segment of an input that a segment goes back to."""
            passed: set[str] = set()  # damaged names may form a ring
            while before.get(segment) in before and segment not in passed:
                passed.add(segment)
                segment = before[segment]
            return segment

        last = {first(one.segment): one for one in visible}
        found: dict[Commit, list[Commit]] = {}
        for commit in hidden:
            if commit.segment in there and (after := last.get(first(commit.segment))) is not None:
                found.setdefault(after, []).append(commit)
        return found

    def after(self, ended: Ended) -> Iterator[Task]:
        """None: a segment is one task."""
        del ended
        return iter(())

    def remarks(self) -> list[str]:
        """None."""
        return []
