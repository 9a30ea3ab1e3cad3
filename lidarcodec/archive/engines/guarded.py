"""What a worker of a cluster does: it gives a task to a process of its own, and ends that process if it takes too long
or too much memory. The cluster's worker lives on.
"""

from __future__ import annotations

import subprocess
import threading
from typing import Final

from lidarcodec.archive.engines.processes import ProcessEngine
from lidarcodec.archive.tasks import Ended, Task

_WAIT_S: Final = 60.0
_here = threading.local()
"""Holds `engine` and its limits for each thread, so that a process does many tasks."""


def guarded(task: Task, timeout_s: float, memory_mb: int | None) -> Ended:
    """Do a task within limits of time and of resident memory in MB. What this machine lacks for it ends the task."""
    limits = timeout_s, memory_mb
    try:
        if getattr(_here, "limits", None) != limits:
            _forget()
            _here.engine, _here.limits = _Kept(1, timeout_s, memory_mb), limits
        _here.engine.submit(task)
        found: list[Ended] = []
        while not found:
            found = _here.engine.ended(_WAIT_S)
    except (OSError, MemoryError, subprocess.SubprocessError) as error:  # a full disk, or no more processes
        _forget()
        return Ended(task, "store", why=f"no process for it: {type(error).__name__}: {error}"[:1000])
    except BaseException:  # the cluster interrupts it: the next task begins with a new process
        _forget()
        raise
    return found[0]


def _forget() -> None:
    if hasattr(_here, "engine"):
        _here.engine.close()
        del _here.engine, _here.limits


class _Kept(ProcessEngine):
    """Ends with the thread that holds it."""

    def __del__(self) -> None:
        if hasattr(self, "_scratch"):  # otherwise it was never made
            self.close()
