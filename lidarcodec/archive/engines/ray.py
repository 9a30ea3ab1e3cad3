"""The engine for a Ray cluster that runs already (extra `ray`)."""

from __future__ import annotations

import logging
import socket
import time
from contextlib import suppress
from typing import Any, Final

from lidarcodec.archive.engines.guarded import guarded
from lidarcodec.archive.tasks import Ended, Task
from lidarcodec.errors import SourceError

_CONNECT_S: Final = 10.0
_GRACE_S: Final = 30.0
"""A worker that has not ended a task so long after its time is ended itself."""


class RayEngine:
    """Tasks on a Ray cluster, at its head such as `10.0.0.5:6379` (from a machine of the cluster) or
    `ray://10.0.0.5:10001` (from any other).

    timeout_s, memory_mb: a task that takes longer or more resident memory is ended. Ray also gives a machine no more
        tasks than so much memory allows
    """

    def __init__(self, address: str, timeout_s: float, memory_mb: int | None = None) -> None:
        """Raises SourceError if no cluster answers there, or it has no processors."""
        import ray

        self._knock(address)
        self._ray: Any = ray
        self._address, self._timeout_s, self._memory_mb = address, timeout_s, memory_mb
        try:
            ray.init(address=address, log_to_driver=False, configure_logging=False, logging_level=logging.ERROR)
            processors = int(ray.cluster_resources().get("CPU", 0))
        except Exception as error:  # Ray raises ConnectionError, ValueError, RuntimeError and errors of gRPC
            ray.shutdown()
            raise SourceError(f"no Ray cluster at {address}: {error}") from None
        if not processors:
            ray.shutdown()
            raise SourceError(f"the Ray cluster at {address} has no processors: start a worker")
        # no more tasks than can run at once, because the time of a task counts from here
        self.slots = processors if memory_mb is None else min(processors, self._room(memory_mb))
        if not self.slots:
            ray.shutdown()
            raise SourceError(f"no machine of the Ray cluster at {address} has {memory_mb} MB: give a smaller --memory")
        more = {} if memory_mb is None else {"memory": memory_mb * 1_000_000}
        self._work = ray.remote(num_cpus=1, max_retries=0, **more)(guarded)
        self._running: dict[Any, tuple[Task, float]] = {}

    @staticmethod
    def _knock(address: str) -> None:
        """Raise SourceError if nobody listens there: Ray itself tries for minutes, and fills the terminal."""
        host, _, port = address.removeprefix("ray://").rpartition(":")
        if not host or not port.isdecimal() or int(port) > 65535:
            raise SourceError(f"{address} is not an address of a Ray cluster: give HOST:PORT or ray://HOST:PORT")
        try:
            socket.create_connection((host.strip("[]"), int(port)), _CONNECT_S).close()
        except OSError as error:
            raise SourceError(f"no Ray cluster at {address}: {error}") from None

    def submit(self, task: Task) -> None:
        self._running[self._remote(task)] = task, time.monotonic()

    def _room(self, memory_mb: int) -> int:
        """How many tasks of so much memory the machines of the cluster have room for."""
        nodes = [one["Resources"] for one in self._ray.nodes() if one["Alive"]]
        return sum(int(one.get("memory", 0) // (memory_mb * 1_000_000)) for one in nodes)

    def _remote(self, task: Task) -> Any:
        try:
            return self._work.remote(task, self._timeout_s, self._memory_mb)
        except Exception as error:  # of many kinds, as above
            raise self._gone(error) from None

    def _gone(self, error: Exception) -> OSError:
        return OSError(
            f"the Ray cluster at {self._address} is gone ({type(error).__name__}): run the same command again to "
            "continue"
        )

    def ended(self, wait_s: float) -> list[Ended]:
        found: list[Ended] = []
        if self._running:
            try:
                ready, _ = self._ray.wait(list(self._running), num_returns=1, timeout=wait_s)
                more, _ = self._ray.wait(list(self._running), num_returns=len(self._running), timeout=0)
            except Exception as error:
                raise self._gone(error) from None
            found += [self._end(ref) for ref in dict.fromkeys((*ready, *more))]
        for ref, (task, begun_s) in list(self._running.items()):
            if time.monotonic() - begun_s > self._timeout_s + _GRACE_S:
                del self._running[ref]
                self._cancel(ref)
                found.append(Ended(task, "late", why=f"it took more than {self._timeout_s:g} s"))
        return found

    def _end(self, ref: Any) -> Ended:
        task, _ = self._running.pop(ref)
        errors = self._ray.exceptions
        try:
            ended = self._ray.get(ref)
        except errors.RayTaskError as error:  # `guarded` returns errors of the task: the worker cannot load it
            return Ended(task, "missing", why=f"a worker cannot do it: {str(error).splitlines()[-1]}")
        except (errors.WorkerCrashedError, errors.NodeDiedError, errors.OutOfMemoryError) as error:
            return Ended(task, "killed", why=f"the cluster lost it: {type(error).__name__}")
        except Exception as error:
            raise self._gone(error) from None
        return Ended(task, ended.how, ended.result, ended.why)

    def _cancel(self, ref: Any) -> None:
        with suppress(Exception):  # the cluster is gone, and the task with it
            self._ray.cancel(ref, force=True)

    def close(self) -> None:
        for ref in self._running:
            self._cancel(ref)
        self._running.clear()
        self._ray.shutdown()
