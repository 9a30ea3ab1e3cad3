"""The default engine: worker processes of this machine. One that dies or takes too long is replaced."""

from __future__ import annotations

import contextlib
import logging
import multiprocessing
import shutil
import signal
import tempfile
import time
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any, Final

from lidarcodec.archive.scratch import forget
from lidarcodec.archive.tasks import Ended, Task, work
from lidarcodec.untrusted.children import safe_path

log = logging.getLogger(__name__)

_END_S: Final = 5.0
"""Time to end before a worker is killed."""


class ProcessEngine:
    """Tasks in `count` processes. timeout_s: a task that takes longer is ended with its process"""

    def __init__(self, count: int, timeout_s: float) -> None:
        self.slots = count
        self._timeout_s = timeout_s
        self._context = multiprocessing.get_context("spawn")
        self._workers: list[_Worker] = []
        self._scratch = tempfile.mkdtemp(prefix="lidarcodec-archive-")

    def submit(self, task: Task) -> None:
        idle = next((one for one in self._workers if one.task is None), None)
        if idle is None:
            idle = _Worker(self._context, self._scratch)
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

    def __init__(self, context: Any, scratch: str) -> None:
        self.pipe, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, scratch), daemon=True)
        with safe_path():
            self._process.start()
        theirs.close()
        self.pid: int = self._process.pid
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
            self.kill()
            return Ended(task, "killed", why=f"its process ended with {_named(self._process.exitcode)}")
        return Ended(task, ended.how, ended.result, ended.why)

    def kill(self) -> None:
        """End the process at once."""
        self.alive, self.task = False, None
        self._process.kill()
        self._process.join()
        self.pipe.close()

    def end(self) -> None:
        """End the process: an idle one by itself."""
        if self.task is None:
            self.pipe.close()
            self._process.join(_END_S)
        self.kill()


def _named(code: int | None) -> str:
    if code is not None and code < 0:
        with contextlib.suppress(ValueError):
            return signal.Signals(-code).name
    return f"exit code {code}"


def _serve(pipe: Connection, scratch: str) -> None:
    """Do tasks until the other end of the pipe is closed. scratch: folder for downloads, shared by all workers"""
    tempfile.tempdir = scratch
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that gives the tasks
    logging.basicConfig(level=logging.ERROR, format="lidarcodec: %(message)s")
    try:
        while True:
            pipe.send(work(pipe.recv()))
    except (EOFError, OSError):
        pass
    finally:
        forget()
        with contextlib.suppress(OSError):  # the parent was killed, and this is its last worker
            Path(scratch).rmdir()
