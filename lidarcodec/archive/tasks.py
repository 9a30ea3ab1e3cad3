"""Task: a piece of work that any process can do, and `work`, which does it.

A task is made of plain values, so that every engine can carry it. What it does is visible in the store only by objects
that are created once; a task that is done twice changes nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

from lidarcodec.archive.jobs.table import work_of
from lidarcodec.archive.stores.table import open_store
from lidarcodec.errors import LidarCodecError, MissingExtraError
from lidarcodec.untrusted.text import printable


@dataclass(frozen=True)
class Task:
    """kind: a job, or `cut`;  key: unique among the tasks of a run;  label: for people
    source, target: what `open_store` takes;  value: plain values for the function
    """

    kind: str
    key: str
    label: str
    source: str
    target: str
    value: dict[str, Any] = field(default_factory=dict)


End = Literal["done", "refused", "failed", "store", "killed", "late", "large", "missing"]


@dataclass(frozen=True)
class Ended:
    """A task that ended.

    how: `done`; `refused`: it cannot be done with this input and these settings, again would be no better; `failed`;
         `store`: a store, the disk or the memory failed; `killed`: its process died; `late`: it took too long;
         `large`: it took too much memory; `missing`: an optional dependency is not installed
    result: what its function returned;  why: the error
    """

    task: Task
    how: End
    result: dict[str, Any] = field(default_factory=dict)
    why: str = ""


def work(task: Task) -> Ended:
    """Do a task here. Errors become an Ended."""
    try:
        source, target = open_store(task.source), open_store(task.target)
        return Ended(task, "done", work_of(task.kind)(task.value, source, target))
    except MissingExtraError as error:
        return Ended(task, "missing", why=str(error))
    except (OSError, MemoryError) as error:  # first: lack of memory in a query is a LidarCodecError as well
        return Ended(task, "store", why=_told(error, task))
    except LidarCodecError as error:
        return Ended(task, "refused", why=_told(error, task))
    except Exception as error:  # an engine must not end because of one task
        return Ended(task, "failed", why=_told(error, task))


def _told(error: Exception, task: Task) -> str:
    """The error in a line, without names of local files: they differ between machines."""
    text = " ".join(str(error).split()) or type(error).__name__
    name = str(task.value.get("name", "")).rstrip("/")
    words = []
    for word in text.split(" "):
        bare = word.strip("'\":,()")
        local = bare.startswith("/") and name and bare.rpartition("/")[2] == name.rpartition("/")[2]
        words.append(word.replace(bare, name) if local else word)
    kind = "" if isinstance(error, LidarCodecError | OSError) else f"{type(error).__name__}: "
    return printable(kind + " ".join(words))[:1000]
