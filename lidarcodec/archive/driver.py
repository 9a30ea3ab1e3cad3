"""Gives tasks to an engine until all have ended. It holds no state that matters: after a crash, a new one continues."""

from __future__ import annotations

import heapq
import logging
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import count
from typing import Any, Final, Protocol

from lidarcodec.archive.contents import set_aside
from lidarcodec.archive.engines.base import Engine
from lidarcodec.archive.stores.base import Store
from lidarcodec.archive.tasks import Ended, Task
from lidarcodec.errors import SettingsError

logger = logging.getLogger(__name__)

TRIES: Final = 3
"""A task that failed so often is set aside."""
KILLS: Final = 12
"""The same for a task whose process was killed: mostly not its fault."""
MADE_OF_INPUTS: Final = frozenset({"cut", "compress"})
"""Kinds of tasks whose failures are kept in the archive; those of other jobs are tried again by their next run."""
PAUSE_S: Final = 0.5
"""Before the second try; each further pause is twice as long."""
_WAIT_S: Final = 0.2


class Plan(Protocol):
    """What is to be done. counts: `inputs` or segments, `finished` those with nothing left to do, and others"""

    counts: Counter[str]

    def tasks(self) -> Iterator[Task]:
        """Tasks to begin with."""

    def after(self, ended: Ended) -> Iterator[Task]:
        """Tasks that follow from one that was done."""

    def remarks(self) -> list[str]:
        """What a person should know of the plan, a line each."""


@dataclass
class Outcome:
    """What a run did.

    counts: sums of the results, number of tasks by kind, `tried_again`, `done_twice`
    aside: label and reason of each task that was set aside;  left: of each that a store did not allow
    results: of tasks whose results are shown;  complete: whether it ran to its end;  tasks: done ones
    """

    counts: Counter[str] = field(default_factory=Counter)
    aside: list[tuple[str, str]] = field(default_factory=list)
    left: list[tuple[str, str]] = field(default_factory=list)
    results: list[dict[str, Any]] = field(default_factory=list)
    complete: bool = True
    tasks: int = 0


def drive(
    plan: Plan,
    engine: Engine,
    target: Store,
    *,
    stopped: Callable[[], bool] = lambda: False,
    tick: Callable[[], None] = lambda: None,
    pause_s: float = PAUSE_S,
) -> Outcome:
    """Run all tasks of a plan. Those that cannot be done are set aside with the reason.

    stopped: whether to end early;  tick: called after each task
    Raises SettingsError if workers lack an optional dependency, OSError if the target fails.
    """
    outcome, begin = Outcome(), plan.tasks()
    failures: Counter[str] = Counter()
    kills: Counter[str] = Counter()
    follow: list[Iterator[Task]] = []
    waiting: list[tuple[float, int, Task]] = []
    numbers, running = count(), 0

    def next_task() -> Task | None:
        if waiting and waiting[0][0] <= time.monotonic():
            return heapq.heappop(waiting)[2]
        while follow:  # the segments of an input follow its cut, while a worker still has the input
            if (task := next(follow[0], None)) is not None:
                return task
            follow.pop(0)
        return next(begin, None)

    while not stopped():
        while running < engine.slots and (task := next_task()) is not None:
            engine.submit(task)
            running += 1
        if not running and not waiting:
            return outcome
        if not running:
            time.sleep(min(_WAIT_S, max(0.0, waiting[0][0] - time.monotonic())))
        for ended in engine.ended(_WAIT_S) if running else []:
            running -= 1
            if ended.how == "done":
                _note(outcome, ended)
                follow.append(plan.after(ended))
                tick()
                continue
            if ended.how == "missing":
                raise SettingsError(f"the workers cannot run these tasks: {ended.why}")
            key = ended.task.key
            (kills if ended.how == "killed" else failures)[key] += 1
            if ended.how == "refused" or failures[key] >= TRIES or kills[key] >= KILLS:
                if ended.how == "store":  # the next run tries it again
                    outcome.left.append((ended.task.label, ended.why))
                else:
                    if ended.task.kind in MADE_OF_INPUTS:
                        origin, _, segment = key.partition("-")
                        set_aside(target, origin, segment, ended.task.label, ended.why)
                    outcome.aside.append((ended.task.label, ended.why))
                tick()
                continue
            outcome.counts["tried_again"] += 1
            logger.info("%s is tried again: %s", ended.task.label, ended.why)
            pause = pause_s * 2 ** (failures[key] + kills[key] - 1)
            heapq.heappush(waiting, (time.monotonic() + min(pause, 60.0), next(numbers), ended.task))
    outcome.complete = False
    return outcome


def _note(outcome: Outcome, ended: Ended) -> None:
    outcome.tasks += 1
    outcome.counts[ended.task.kind] += 1
    for name, value in ended.result.items():
        if isinstance(value, int) and not isinstance(value, bool):
            outcome.counts[name] += value
    if not ended.result.get("won", True):
        outcome.counts["done_twice"] += 1
    if ended.task.kind == "verify":
        outcome.results.append(ended.result)
