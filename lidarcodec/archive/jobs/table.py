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

Each = Literal["input", "segment", "archive"]


@dataclass(frozen=True)
class Job:
    """A job.

    each: what a task is for: an input of IN, a segment of the archive, or the whole archive. That is no task: it runs
        in the command's own process
    work: module and function
    takes: options of `archive run` that it knows
    changes: whether it makes segments, so that tables are joined at its end
    previews: whether its tasks know `dry`, and then only say what they would do
    """

    each: Each
    work: str
    takes: frozenset[str] = frozenset()
    changes: bool = False
    previews: bool = False


_HERE: Final = "lidarcodec.archive.jobs."
_RENEW: Final = frozenset({"settings", "before", "delete_old", "dry_run"})

JOBS: Final[dict[str, Job]] = {
    "compress": Job("input", f"{_HERE}compress:compress", frozenset({"settings", "seconds", "keep_both", "dry_run"}),
                    changes=True),
    "recompress": Job("segment", f"{_HERE}recompress:recompress", _RENEW, changes=True, previews=True),
    "verify": Job("segment", f"{_HERE}verify:verify", frozenset({"dry_run"})),
    "index": Job("archive", f"{_HERE}joining:join_tables"),
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
