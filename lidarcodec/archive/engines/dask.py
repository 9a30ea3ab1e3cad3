"""The engine for a cluster: a Dask scheduler that runs already (extra `cluster`)."""

from __future__ import annotations

import pickle
import time
from queue import Empty, SimpleQueue
from typing import Any, Final

from lidarcodec.archive.engines.guarded import guarded
from lidarcodec.archive.engines.worker import STATUS, resident_mb
from lidarcodec.archive.tasks import Ended, Task
from lidarcodec.errors import SourceError

_CONNECT_S: Final = 10.0
_ROOM_MB: Final = 128
"""Of the limit of a worker, for its nanny and what varies."""
_LEAST_MB: Final = 256
"""A task is tried with so much in any case."""
_GRACE_S: Final = 30.0
"""A worker that has not ended a task so long after its time is given up."""
_GONE_S: Final = 60.0
"""A scheduler may be away for so long, as when it is started again."""


def done_here(task: Task, timeout_s: float, memory_mb: int | None) -> Ended:
    """Do a task in a worker. Its process may also take no more memory than a thread's share of what the worker's limit
    leaves beside the worker itself."""
    from distributed import get_worker

    worker: Any = get_worker()
    limits = [] if memory_mb is None else [memory_mb]
    if worker.memory_manager.memory_limit and STATUS.exists():
        room_mb = worker.memory_manager.memory_limit / 1e6 - resident_mb() - _ROOM_MB
        limits.append(max(_LEAST_MB, int(room_mb / worker.state.nthreads)))
    return guarded(task, timeout_s, min(limits, default=None))


class _Call:
    """A call of `done_here` that begins when it is unpickled.

    Dask unpickles what it is given before it runs it, and a worker that fails there dies. So it is given bytes and a
    function of Python itself, and a worker without `lidarcodec` says so.
    """

    def __init__(self, task: Task, timeout_s: float, memory_mb: int | None) -> None:
        self._words = task, timeout_s, memory_mb

    def __reduce__(self) -> tuple[Any, ...]:
        return done_here, self._words


class DaskEngine:
    """Tasks on the workers of a scheduler, such as `tcp://10.0.0.5:8786`. When a worker dies, Dask itself runs its
    tasks again on another one.

    timeout_s, memory_mb: a task that takes longer or more resident memory is ended; None: the worker's own limit holds.
    A task whose worker does not do so is given up: until it ends, its thread gets no other
    """

    def __init__(self, address: str, timeout_s: float, memory_mb: int | None = None) -> None:
        """Raises SourceError if no scheduler answers there, or it has no worker."""
        from distributed import Client
        from distributed.scheduler import KilledWorker

        self._cluster_errors = (KilledWorker, OSError, MemoryError)
        try:
            client: Any = Client
            self._client = client(address, timeout=_CONNECT_S, set_as_default=False)
            self._client.wait_for_workers(1, timeout=_CONNECT_S)
        except (OSError, TimeoutError, ValueError) as error:
            raise SourceError(f"no Dask cluster with workers at {address}: {error}") from None
        # a task for each thread, and no more, because the time of a task counts from when it is handed out
        self._threads = self.slots = max(1, sum(self._client.nthreads().values()))
        self._timeout_s, self._memory_mb, self._address = timeout_s, memory_mb, address
        self._seen_s = time.monotonic()
        self._done: SimpleQueue[Any] = SimpleQueue()
        self._running: dict[Any, tuple[Task, float]] = {}
        self._late: set[Any] = set()

    def submit(self, task: Task) -> None:
        self._check()
        call = pickle.dumps(_Call(task, self._timeout_s, self._memory_mb))
        future = self._client.submit(pickle.loads, call, pure=False, retries=0)
        self._running[future] = task, time.monotonic()
        future.add_done_callback(self._done.put)

    def ended(self, wait_s: float) -> list[Ended]:
        self._check()
        found = []
        try:
            future = self._done.get(timeout=wait_s) if self._running else None
            while future is not None:
                if future in self._running:
                    found.append(self._end(future))
                self._late.discard(future)
                future = self._done.get_nowait()
        except Empty:
            pass
        for future, (task, begun_s) in list(self._running.items()):
            if time.monotonic() - begun_s > self._timeout_s + _GRACE_S:
                del self._running[future]
                self._late.add(future)
                found.append(Ended(task, "late", why=f"it took more than {self._timeout_s:g} s"))
        self.slots = max(1, self._threads - len(self._late))
        return found

    def _check(self) -> None:
        """Raise OSError if the scheduler is gone for long. One that is started again meanwhile gets the tasks again."""
        now_s = time.monotonic()
        if self._client.status == "running":
            self._seen_s = now_s
        if self._client.status == "closed" or now_s - self._seen_s > _GONE_S:
            raise OSError(f"the Dask scheduler at {self._address} is gone: run the same command again to continue")

    def _end(self, future: Any) -> Ended:
        task, _ = self._running.pop(future)
        error = future.exception() if future.status in ("error", "lost") else None
        if error is None and future.status == "finished":
            ended = future.result()
            return Ended(task, ended.how, ended.result, ended.why)
        if isinstance(error, self._cluster_errors) or not isinstance(error, Exception):
            return Ended(task, "killed", why=f"the cluster lost it: {type(error).__name__}")
        # `done_here` returns errors of the task: the worker cannot load it
        return Ended(task, "missing", why=f"a worker cannot do it: {type(error).__name__}: {error}"[:1000])

    def close(self) -> None:
        for future in (*self._running, *self._late):
            future.cancel()
        self._running.clear()
        self._late.clear()
        self._client.close()
