"""What is to be done: the inputs of a store, less what the archive has."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from typing import Any, Final

from lidarcodec.archive.contents import WHOLE, Contents, commits_of
from lidarcodec.archive.inputs import inputs_of
from lidarcodec.archive.names import Commit, id_of
from lidarcodec.archive.segments import Segment
from lidarcodec.archive.stores.base import Store
from lidarcodec.archive.tasks import Ended, Task
from lidarcodec.settings import StreamSettings
from lidarcodec.untrusted.json import read_json
from lidarcodec.wire.header import MAJOR, MINOR

MAX_PLAN: Final = 64 << 20
"""Largest plan that is read, in bytes."""


ALONE: Final = frozenset({"raw", "zstd", "pcodec", "png", "jxl", "jpeg"})
"""Codecs whose frames need no other frame."""


def archive_settings(settings: StreamSettings) -> StreamSettings:
    """Settings for an archive: with such a codec every message is a key message, unless the interval was chosen.

    A frame then is one read.
    """
    if settings.codec not in ALONE or "key_interval" in settings.model_fields_set:
        return settings
    return settings.model_copy(update={"key_interval": 1})


class CompressPlan:
    """The job `compress`: inputs are cut into segments, segments are encoded.

    inputs, finished: number of inputs so far, and of those with nothing left to do
    """

    def __init__(self, source: Store, target: Store, settings: StreamSettings, seconds: float) -> None:
        self._source, self._target, self._seconds = source, target, seconds
        self._settings = settings.model_dump(mode="json")
        self.inputs = self.finished = 0
        self._contents = Contents()

    def tasks(self) -> Iterator[Task]:
        """Tasks to begin with."""
        contents = self._contents = Contents.of(self._target)
        for one in inputs_of(self._source.entries()):
            self.inputs += 1
            origin = one.id(self._settings, self._seconds, [MAJOR, MINOR])
            if contents.finished(origin):
                self.finished += 1
                continue
            value = {"input": asdict(one), "id": origin, "name": one.name, "settings": self._settings}
            task = self._task("cut", f"{origin}-{WHOLE}", one.name[:1000], value | {"seconds": self._seconds})
            if origin not in contents.counts:
                yield task
                continue
            plan = read_json(self._target.read(f"plans/{origin}-{contents.counts[origin]}.json"), MAX_PLAN)
            yield from self._segments(task, plan)

    def after(self, ended: Ended) -> Iterator[Task]:
        """Tasks that follow from one that was done."""
        if ended.task.kind == "cut":
            yield from self._segments(ended.task, ended.result)

    def _segments(self, cutting: Task, plan: dict[str, Any]) -> Iterator[Task]:
        origin = cutting.value["id"]
        value = {name: cutting.value[name] for name in ("input", "name", "settings")}
        value |= {name: plan[name] for name in ("vehicle", "sensor", "not_kept")}
        for number, one in enumerate(plan["segments"]):
            fields = Segment.of(one).plain()
            segment = id_of("segment", origin, fields)
            if not self._contents.has(origin, segment):
                label = f"{cutting.label}, segment {number + 1} of {len(plan['segments'])}"
                more = {"origin": origin, "segment": segment, "range": fields}
                yield self._task("compress", f"{origin}-{segment}", label, value | more)

    def _task(self, kind: str, key: str, label: str, value: dict[str, Any]) -> Task:
        return Task(kind, key, label, self._source.url, self._target.url, value)


class CommitPlan:
    """A job on what is in the archive: one task for each visible segment that has not had it.

    kind: of the tasks, a key of `tasks.WORK`;  more: further values for each task
    """

    def __init__(self, kind: str, source: Store, target: Store, more: dict[str, Any]) -> None:
        self._kind, self._source, self._target, self._more = kind, source, target, more
        self.inputs = self.finished = 0

    def tasks(self) -> Iterator[Task]:
        """A task for each segment."""
        done = {entry.name for entry in self._target.entries("verified/")} if self._kind == "verify" else set()
        before_ns = self._more.get("before_ns")
        commits = commits_of(self._target)
        older = self._replaced(commits) if self._more.get("delete_old") else {}
        for commit in commits:
            self.inputs += 1
            late = before_ns is not None and commit.last_ns >= before_ns
            if late or f"verified/{commit.segment}.json" in done:
                self.finished += 1
                continue
            label = f"{commit.vehicle}/{commit.sensor}, segment {commit.segment[:8]}"
            value = {"commit": list(commit), "name": commit.name} | self._more
            if commit in older:
                value["older"] = [list(one) for one in older[commit]]
            key = f"{commit.origin}-{commit.segment}"
            yield Task(self._kind, key, label, self._source.url, self._target.url, value)

    def _replaced(self, visible: list[Commit]) -> dict[Commit, list[Commit]]:
        """By visible segment the segments before it whose recordings are still there."""
        there = {entry.name.rpartition("/")[2].partition("-")[0] for entry in self._target.entries("recordings/")}
        hidden = commits_of(self._target, hidden=True)
        after = {one.origin: one for one in (*hidden, *visible)}
        found: dict[Commit, list[Commit]] = {}
        for commit in hidden:
            last = commit
            while last.segment in after:
                last = after[last.segment]
            if commit.segment in there:
                found.setdefault(last, []).append(commit)
        return found

    def after(self, ended: Ended) -> Iterator[Task]:
        """None: a segment is one task."""
        del ended
        return iter(())
