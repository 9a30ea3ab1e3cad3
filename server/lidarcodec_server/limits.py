"""Limits: how much each client may ask at once, and how often it may change something. Its memory is bounded, too.

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
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from typing import TypeVar

from lidarcodec.errors import LidarCodecError

MAX_CLIENTS = 1024
"""Clients whose last changes are remembered; the one that asked longest ago gives way."""
SLOTS, SLOTS_A_CLIENT, SLOTS_A_STREAM = 24, 8, 8
"""Changes that wait for vehicles at once, of the 40 threads that serve all requests: in all, of one client, of one
stream."""
LOOKS = 6
"""Further requests that ask vehicles for their settings at once. Where there is no room, what is known is told."""


Key = TypeVar("Key", bound=Hashable)


class TooManyError(LidarCodecError):
    """A client asks too much; `wait_s` is when to try again."""

    def __init__(self, message: str, wait_s: int) -> None:
        super().__init__(message)
        self.wait_s = wait_s


class Meter:
    """What a client may still do now: `rate` times a second, and `burst` times at once. Not thread-safe.

    >>> meter = Meter(rate=10.0, burst=2, now_s=0.0)
    >>> meter.spend(3, 0.0)
    >>> round(meter.wait_s(0.0), 3), meter.wait_s(1.0)
    (0.1, 0.0)
    """

    def __init__(self, rate: float, burst: int, now_s: float) -> None:
        self._rate, self._burst, self._left, self._at_s = rate, burst, float(burst), now_s

    def spend(self, cost: int, now_s: float) -> None:
        """Count something. What is left may become less than none: what costs much is waited for afterwards."""
        self._fill(now_s)
        self._left -= cost

    def wait_s(self, now_s: float) -> float:
        """How long until the next time; 0 when it may be now."""
        self._fill(now_s)
        return max(0.0, -self._left / self._rate)

    def _fill(self, now_s: float) -> None:
        self._left = min(self._burst, self._left + max(0.0, now_s - self._at_s) * self._rate)
        self._at_s = now_s


class SparseLog:
    """Warnings that clients can cause: at most one a second, with the number of those left out. Thread-safe."""

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
        self._changing: Counter[Hashable] = Counter()
        self._looking: set[Hashable] = set()

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
        raise TooManyError(f"at most {self._rate:g} changes a second are allowed: try again in {wait_s} s", wait_s)

    @contextmanager
    def slot(self, client: str, stream: Hashable) -> Iterator[None]:
        """One of the threads that wait for vehicles to change. stream: which one is waited for

        Raises TooManyError when there is none for this client, or for this stream.
        """
        with self._lock:
            full = self._running[client] >= SLOTS_A_CLIENT or self._running.total() >= SLOTS
            if full or self._changing[stream] >= SLOTS_A_STREAM:
                raise TooManyError("too many requests are waiting for vehicles: try again", 1)
            self._running[client] += 1
            self._changing[stream] += 1
        try:
            yield
        finally:
            with self._lock:
                _one_less(self._running, client)
                _one_less(self._changing, stream)

    @contextmanager
    def look(self, stream: Hashable) -> Iterator[bool]:
        """Whether a vehicle may be asked for its settings now: one request of a stream does, and few of all."""
        with self._lock:
            may = stream not in self._looking and len(self._looking) < LOOKS
            if may:
                self._looking.add(stream)
        try:
            yield may
        finally:
            if may:
                with self._lock:
                    self._looking.discard(stream)


def _one_less(counter: Counter[Key], key: Key) -> None:
    counter[key] -= 1
    if not counter[key]:
        del counter[key]
