"""The interface of an engine."""

from __future__ import annotations

from typing import Protocol

from lidarcodec.archive.tasks import Ended, Task


class Engine(Protocol):
    """Runs tasks in other processes. It promises nothing: a task may be lost or done twice.

    slots: tasks that it takes at once
    """

    slots: int

    def submit(self, task: Task) -> None:
        """Begin a task, or keep it until a worker is free."""

    def ended(self, wait_s: float) -> list[Ended]:
        """Tasks that ended since the last call. Waits at most `wait_s` for the first one."""

    def close(self) -> None:
        """End the workers. What they are doing is given up; the store stays clean."""
