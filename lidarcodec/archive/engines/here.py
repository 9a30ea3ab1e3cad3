"""The engine without other processes: tasks run in this one, one after another. For debugging."""

from __future__ import annotations

from collections import deque

from lidarcodec.archive.scratch import forget
from lidarcodec.archive.tasks import Ended, Task, work


class HereEngine:
    """A task runs when its end is asked for. Tasks have no time limit."""

    slots = 1

    def __init__(self) -> None:
        self._tasks: deque[Task] = deque()

    def submit(self, task: Task) -> None:
        self._tasks.append(task)

    def ended(self, wait_s: float) -> list[Ended]:
        del wait_s
        return [work(self._tasks.popleft())] if self._tasks else []

    def close(self) -> None:
        forget()
