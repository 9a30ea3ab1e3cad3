"""Limits: how much each client may ask at once, and how often it may change something. Bounded, whoever asks.

>>> clock = [0.0]
>>> limits = Limits(rate=1.0, burst=2, clock=lambda: clock[0])
>>> limits.change("ada"); limits.change("ada")
>>> try: limits.change("ada")
... except TooManyError as error: print(error.wait_s)
1
>>> clock[0] = 1.0; limits.change("ada")
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections import Counter, OrderedDict
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from lidarcodec.errors import LidarCodecError

MAX_CLIENTS = 1024
"""Clients whose last changes are remembered; the one that asked longest ago gives way."""
SLOTS, SLOTS_A_CLIENT = 24, 8
"""Requests that wait for vehicles at once, of the 40 threads that serve all requests."""


class TooManyError(LidarCodecError):
    """A client asks too much; `wait_s` is when to try again."""

    def __init__(self, message: str, wait_s: int) -> None:
        super().__init__(message)
        self.wait_s = wait_s


class SparseLog:
    """Warnings that somebody outside can cause: at most one a second, and how many were left out. Thread-safe."""

    def __init__(self, logger: logging.Logger, every_s: float = 1.0) -> None:
        self._logger, self._every_s = logger, every_s
        self._lock = threading.Lock()
        self._due, self._left_out = float("-inf"), 0

    def warning(self, message: str, *values: object) -> None:
        """Log it, or count it."""
        with self._lock:
            now = time.monotonic()
            if now < self._due:
                self._left_out += 1
                return
            self._due, left_out, self._left_out = now + self._every_s, self._left_out, 0
        self._logger.warning(message + (f" ({left_out} more before)" if left_out else ""), *values)


class Limits:
    """Counts what clients do. Thread-safe.

    rate, burst: changes a second of one client, and how many of them at once
    """

    def __init__(self, rate: float = 10.0, burst: int = 20, clock: Callable[[], float] = time.monotonic) -> None:
        self._rate, self._burst, self._clock = rate, burst, clock
        self._lock = threading.Lock()
        self._left: OrderedDict[str, tuple[float, float]] = OrderedDict()
        self._running: Counter[str] = Counter()

    def change(self, client: str) -> None:
        """A client changes something.

        Raises TooManyError when it does so too often.
        """
        with self._lock:
            now = self._clock()
            left, at = self._left.get(client, (float(self._burst), now))
            left = min(self._burst, left + (now - at) * self._rate)
            if left >= 1:
                self._left[client] = left - 1, now
                self._left.move_to_end(client)
                while len(self._left) > MAX_CLIENTS:
                    self._left.popitem(last=False)
                return
        wait_s = math.ceil((1 - left) / self._rate)
        raise TooManyError(f"more than {self._rate:g} changes a second: try again in {wait_s} s", wait_s)

    @contextmanager
    def slot(self, client: str) -> Iterator[None]:
        """One of the threads that wait for vehicles.

        Raises TooManyError when there is none for this client.
        """
        with self._lock:
            if self._running[client] >= SLOTS_A_CLIENT or self._running.total() >= SLOTS:
                raise TooManyError("too many requests wait for vehicles: try again", 1)
            self._running[client] += 1
        try:
            yield
        finally:
            with self._lock:
                self._running[client] -= 1
                if not self._running[client]:
                    del self._running[client]
