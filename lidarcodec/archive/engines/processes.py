"""The default engine: worker processes of this machine. One that dies or takes too much is replaced."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from multiprocessing.connection import Pipe, wait
from pathlib import Path
from typing import Final

import lidarcodec
from lidarcodec.archive.engines.worker import OVER
from lidarcodec.archive.tasks import Ended, Task

_END_S: Final = 5.0
"""Time to end before a worker is killed."""
_HOME: Final = str(Path(lidarcodec.__file__).parents[1])


class ProcessEngine:
    """Tasks in `count` processes.

    timeout_s: a task that takes longer is ended with its process
    memory_mb: the same for one whose process has more resident memory, in MB; None: no limit
    """

    def __init__(self, count: int, timeout_s: float, memory_mb: int | None = None) -> None:
        self.slots = count
        self._timeout_s, self._memory_mb = timeout_s, memory_mb
        self._workers: list[_Worker] = []
        self._scratch = Path(tempfile.mkdtemp(prefix="lidarcodec-archive-"))

    def submit(self, task: Task) -> None:
        idle = next((one for one in self._workers if one.task is None), None)
        if idle is None:
            idle = _Worker(self._scratch, self._memory_mb)
            self._workers.append(idle)
        if not idle.give(task):  # it died while it was idle
            self._workers.remove(idle)
            self.submit(task)

    def ended(self, wait_s: float) -> list[Ended]:
        busy = [one for one in self._workers if one.task is not None]
        now_s = time.monotonic()
        limit_s = min([wait_s, *(max(0.0, one.begun_s + self._timeout_s - now_s) for one in busy)])
        if not busy:
            return []
        ready = set(wait([one.pipe for one in busy], limit_s))
        ended = [one.take() for one in busy if one.pipe in ready]
        for one in busy:
            if one.task is not None and time.monotonic() - one.begun_s >= self._timeout_s:
                late = one.task
                one.kill()
                ended.append(Ended(late, "late", why=f"it took more than {self._timeout_s:g} s"))
        self._workers = [one for one in self._workers if one.alive]
        return ended

    def close(self) -> None:
        for one in self._workers:
            one.end()
        self._workers.clear()
        shutil.rmtree(self._scratch, ignore_errors=True)

    @property
    def pids(self) -> list[int]:
        """Numbers of the worker processes."""
        return [one.pid for one in self._workers]


class _Worker:
    """A process and the pipe to it. task: what it is doing, since `begun_s`"""

    def __init__(self, scratch: Path, memory_mb: int | None) -> None:
        self._folder, self._memory_mb = tempfile.mkdtemp(dir=scratch), memory_mb
        self.pipe, theirs = Pipe()
        words = [str(theirs.fileno()), self._folder, str(os.getpid()), str(memory_mb or 0)]
        path = os.pathsep.join(filter(None, (_HOME, os.environ.get("PYTHONPATH"))))
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "lidarcodec.archive.engines.worker", *words],
                stdin=subprocess.DEVNULL,
                env=os.environ | {"PYTHONPATH": path},
                pass_fds=[theirs.fileno()],
                process_group=0,  # Ctrl-C is for the process that gives the tasks
            )
        self.pid = self._process.pid
        self.task: Task | None = None
        self.begun_s = 0.0
        self.alive = True

    def give(self, task: Task) -> bool:
        """Begin a task. Returns whether the process took it."""
        try:
            self.pipe.send(task)
        except OSError:
            self.kill()
            return False
        self.task, self.begun_s = task, time.monotonic()
        return True

    def take(self) -> Ended:
        """The end of its task. The pipe must be ready."""
        task, self.task = self.task, None
        if task is None:
            raise RuntimeError("this worker has no task")
        try:
            ended = self.pipe.recv()
        except (EOFError, OSError):
            self._wait()
            self.kill()
            if self._process.returncode == OVER:
                return Ended(task, "large", why=f"it needed more than {self._memory_mb:,} MB of memory")
            return Ended(task, "killed", why=f"its process ended with {_named(self._process.returncode)}")
        return Ended(task, ended.how, ended.result, ended.why)

    def kill(self) -> None:
        """End the process at once, and remove its files."""
        self.alive, self.task = False, None
        self._process.kill()
        self._wait()  # one that waits for a dead disk is left to its end
        self.pipe.close()
        shutil.rmtree(self._folder, ignore_errors=True)

    def end(self) -> None:
        """End the process: an idle one by itself."""
        if self.task is None:
            self.pipe.close()
            self._wait()
        self.kill()

    def _wait(self) -> None:
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(_END_S)


def _named(code: int | None) -> str:
    if code is None:
        return "no word"
    if code < 0:
        with contextlib.suppress(ValueError):
            return signal.Signals(-code).name
    return f"exit code {code}"
