"""WorkerKeeper: manages the process of one stream's codec. It starts the process when needed, and after a failure.

After the first failure it starts a new process at once. Each further failure within a minute doubles the pause before
the next start, up to ten seconds. So even if every frame crashes the codec, the stream continues, reports the failures,
and uses little of the machine.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any, Final, Protocol, TypeVar

from lidarcodec.apps.worker.process import START_S, WorkerProcess
from lidarcodec.errors import WorkerError

logger = logging.getLogger(__name__)
T = TypeVar("T")

LIMIT_S: Final = 5.0
"""A codec that has not answered for so long hangs. Usually it needs 5 to 25 ms for a frame."""
WINDOW_S: Final = 60.0
FIRST_REST_S: Final = 0.25
LONGEST_REST_S: Final = 10.0
STORM: Final = 5
"""After so many failures within WINDOW_S a warning is logged."""
TICK_S: Final = 0.2


class Session(Protocol):
    """An encoder or decoder in the process; only one at a time."""

    def open(self, process: WorkerProcess) -> None:
        """Start again in this process."""


class WorkerKeeper:
    """The process of one stream's codec, or none. Thread-safe.

    on_failure: called with each failure, in the thread that detected it
    codec: the codec that a process loads at its start; None: none
    restarts: number of processes started after a failure;  last_failure: reason of the last failure
    """

    def __init__(self, on_failure: Callable[[WorkerError], object], limit_s: float = LIMIT_S) -> None:
        self._on_failure, self._limit_s = on_failure, limit_s
        self._lock = threading.Lock()
        self._process: WorkerProcess | None = None
        self._session: Session | None = None
        self._failures: deque[float] = deque(maxlen=64)
        self._not_before = float("-inf")
        self._restart = False
        self._closed = threading.Event()
        self.codec: str | None = None
        self._used_s = float("-inf")
        self.last_failure: str | None = None
        self.restarts = 0

    # --- for sessions -----------------------------------------------------------------------------------------------

    def holds(self, session: Session) -> bool:
        """Whether the process has this session with all its state."""
        return self._session is session

    def run(self, session: Session, do: Callable[[WorkerProcess], T]) -> T:
        """Open the session in the process if needed, and call `do` with the process. Returns the result of `do`.

        Waits for a process that is starting. Raises WorkerError if it fails, or none may be started after failures.
        """
        end = time.monotonic() + START_S
        while not self.ready(TICK_S):
            if self._closed.is_set() or self.rests or time.monotonic() > end:
                raise WorkerError(f"the codec process is not running: {self.last_failure}", "not there", resting=True)
        with self._lock:
            process = self._process
        if process is None:
            raise WorkerError("the codec process was ended", "not there", resting=True)
        self._used_s = time.monotonic()
        try:
            if self._session is not session:
                self._session = None
                session.open(process)
                self._session = session
            return do(process)
        except WorkerError as error:
            self._lost(process, error)
            raise

    # --- for the stream ---------------------------------------------------------------------------------------------

    @property
    def rests(self) -> bool:
        """Whether there is no process and, because of failures, none will be started for a while."""
        with self._lock:
            return self._process is None and time.monotonic() < self._not_before

    def start(self, codec: str) -> None:
        """Start a process that loads this codec. Does not wait."""
        with self._lock:
            self.codec = codec
        self.ready(0.0)

    def ready(self, timeout_s: float) -> bool:
        """Whether the process can take a request now. Starts one if needed, and waits for at most `timeout_s`."""
        try:
            process = self._begun()
        except WorkerError as error:
            self._lost(None, error)
            return False
        if process is None:
            self._closed.wait(max(0.0, min(timeout_s, self._not_before - time.monotonic())))
            return False
        try:
            return process.ready(timeout_s)
        except WorkerError as error:
            self._lost(process, error)
            return False

    def end_if_unused(self, for_s: float = 0.0) -> None:
        """End the process if it had no request for `for_s`."""
        with self._lock:
            if self._process is None or time.monotonic() - self._used_s < for_s:
                return
            process, self._process, self._session = self._process, None, None
        process.end()

    def close(self) -> None:
        """End the process permanently. Calls that wait for it raise WorkerError. A second call does nothing."""
        self._closed.set()
        with self._lock:
            process, self._process, self._session = self._process, None, None
        if process is not None:
            process.end()

    def state(self) -> dict[str, Any] | None:
        """For the status: id and state of the process, restarts, the last failure; None if there never was a
        process.
        """
        with self._lock:
            if self._process is None and not self.restarts and self.last_failure is None:
                return None
            rest_s = self._not_before - time.monotonic()
            return {
                "pid": None if self._process is None else self._process.pid,
                "state": "running" if self._process is not None else "resting" if rest_s > 0 else "none",
                "restarts": self.restarts,
                "last_failure": self.last_failure,
            }

    # --- inside -----------------------------------------------------------------------------------------------------

    def _begun(self) -> WorkerProcess | None:
        """The process. It is started if there is none and a start is allowed. A process that has ended is replaced."""
        with self._lock:
            process = self._process
        if process is not None and process.ended:
            self._lost(process, process.failure())
        with self._lock:
            if self._process is None and not self._closed.is_set() and time.monotonic() >= self._not_before:
                process = WorkerProcess(self._limit_s)
                process.load(self.codec)
                self._process = process
                self._used_s = time.monotonic()
                self.restarts += self._restart
                self._restart = False
            return self._process

    def _lost(self, process: WorkerProcess | None, error: WorkerError) -> None:
        """Record a failure, and the earliest time of the next start."""
        with self._lock:
            if self._process is not process or self._closed.is_set():
                return
            self._process = self._session = None
            now = time.monotonic()
            self._failures.append(now)
            count = sum(now - at <= WINDOW_S for at in self._failures)
            rest_s = 0.0 if count == 1 else min(FIRST_REST_S * 2.0 ** (count - 2), LONGEST_REST_S)
            self._not_before = now + rest_s
            self._restart, self.last_failure = True, str(error)
        if process is not None:
            process.end()
        self._on_failure(error)
        if count == STORM:
            logger.warning("the codec process failed %d times within a minute: it is now restarted less often", count)
