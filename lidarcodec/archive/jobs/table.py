"""The table of jobs: what `archive run --job NAME` can do. A job is one function, and one line here.

The function takes the plain values of a task, the store IN and the store OUT, and returns plain values. It may be done
twice, by anyone: what it makes, it creates under a name that follows from the task.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Any, Final, Literal, Protocol, cast

from lidarcodec.archive.stores.base import Store
from lidarcodec.errors import UnknownNameError

Each = Literal["input", "segment", "square", "archive"]


def _set(names: str) -> frozenset[str]:
    return frozenset(names.split())


@dataclass(frozen=True)
class Job:
    """A job.

    each: what a task is for: an input of IN, a segment of the archive, a square of the ground, or the whole archive.
        The last is no task: it runs in the command's own process
    work: module and function
    takes: options of `archive run` that it knows
    changes: whether it makes segments, so that tables are joined at its end
    leaves: whether IN is the archive, and OUT a folder or bucket for what is made of it; otherwise OUT is the archive
    previews: whether its tasks know `dry`, and then only say what they would do
    """

    each: Each
    work: str
    takes: frozenset[str] = frozenset()
    changes: bool = False
    previews: bool = False
    leaves: bool = False


_HERE: Final = "lidarcodec.archive.jobs."
_COMMANDS: Final = "lidarcodec.commands.archive.jobs."

JOBS: Final[dict[str, Job]] = {
    "compress": Job("input", f"{_HERE}compress:compress", _set("settings seconds keep_both dry_run"), changes=True),
    "recompress": Job("segment", f"{_HERE}recompress:recompress", _set("settings policy before delete_old dry_run"),
                      changes=True, previews=True),
    "reduce": Job("segment", f"{_HERE}recompress:recompress", _set("settings before delete_old dry_run"),
                  changes=True, previews=True),
    "verify": Job("segment", f"{_HERE}verify:verify", _set("dry_run")),
    "convert": Job("segment", f"{_COMMANDS}convert:convert", _set("as dry_run"), leaves=True),
    "map": Job("square", f"{_COMMANDS}map:build_map", _set("dry_run"), leaves=True),
    "index": Job("archive", f"{_HERE}joining:join_tables"),
    "stats": Job("archive", f"{_HERE}stats:stats"),
}  # fmt: skip
CUT: Final = f"{_HERE}cutting:cut_input"
"""What comes before the job of an input."""


class Work(Protocol):
    """What a task does."""

    def __call__(self, value: dict[str, Any], source: Store, target: Store) -> dict[str, Any]: ...


def job_of(name: str) -> Job:
    """The job of that name. Raises UnknownNameError."""
    if name not in JOBS:
        raise UnknownNameError("job", name, JOBS)
    return JOBS[name]


def work_of(kind: str) -> Work:
    """What does a task of a kind: a job, or `cut`. Raises UnknownNameError."""
    module, _, name = (CUT if kind == "cut" else job_of(kind).work).partition(":")
    return cast(Work, getattr(import_module(module), name))


def takers(option: str) -> list[str]:
    """Names of the jobs that know an option."""
    return [name for name, job in JOBS.items() if option in job.takes]
