"""Limits: how many requests a client may have at once, and how often it may change something. Memory is bounded.

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
from typing import Final, TypeVar

from lidarcodec.errors import LidarCodecError

MAX_CLIENTS = 1024
"""Number of clients whose last changes are remembered; the one with the oldest request is dropped."""
SLOTS, SLOTS_A_CLIENT, SLOTS_A_STREAM = 24, 8, 8
"""Most changes that wait for vehicles at once: of all clients, of one client, and of one stream. 40 threads serve all
requests."""
LOOKS = 6
"""Most requests that ask vehicles for their settings at once. Further requests get the last known settings."""


Key = TypeVar("Key", bound=Hashable)


class TooManyError(LidarCodecError):
    """A client sends too many requests. wait_s: seconds until it may try again"""

    def __init__(self, message: str, wait_s: int) -> None:
        super().__init__(message)
        self.wait_s = wait_s


class Meter:
    """A token bucket: `rate` actions a second, and `burst` of them at once. Not thread-safe.

    >>> meter = Meter(rate=10.0, burst=2, now_s=0.0)
    >>> meter.spend(3, 0.0)
    >>> round(meter.wait_s(0.0), 3), meter.wait_s(1.0)
    (0.1, 0.0)
    """

    def __init__(self, rate: float, burst: int, now_s: float) -> None:
        self._rate, self._burst, self._left, self._at_s = rate, burst, float(burst), now_s

    def spend(self, cost: int, now_s: float) -> None:
        """Count an action. The balance may become negative: the wait for an expensive action comes after it."""
        self._fill(now_s)
        self._left -= cost

    def wait_s(self, now_s: float) -> float:
        """Seconds until the next action is allowed; 0 if it is allowed now."""
        self._fill(now_s)
        return max(0.0, -self._left / self._rate)

    def _fill(self, now_s: float) -> None:
        self._left = min(self._burst, self._left + max(0.0, now_s - self._at_s) * self._rate)
        self._at_s = now_s


class SparseLog:
    """Logs warnings that clients can cause: at most one a second, with the number of omitted ones. Thread-safe."""

    def __init__(self, logger: logging.Logger, every_s: float = 1.0) -> None:
        self._logger, self._every_s = logger, every_s
        self._lock = threading.Lock()
        self._due, self._left_out = float("-inf"), 0

    def warning(self, message: str, *values: object) -> None:
        """Log the warning, or count it as omitted."""
        with self._lock:
            now = time.monotonic()
            if now < self._due:
                self._left_out += 1
                return
            self._due, left_out, self._left_out = now + self._every_s, self._left_out, 0
        self._logger.warning(message + (f" ({left_out} earlier warnings were omitted)" if left_out else ""), *values)


class Looks:
    """Places for questions to vehicles. Thread-safe. most: places for all streams; each stream has one"""

    def __init__(self, most: int) -> None:
        self._most = most
        self._lock = threading.Lock()
        self._looking: set[Hashable] = set()

    @contextmanager
    def look(self, stream: Hashable) -> Iterator[bool]:
        """Whether to ask a vehicle now. If so, its place is taken until the end of the block."""
        with self._lock:
            may = stream not in self._looking and len(self._looking) < self._most
            if may:
                self._looking.add(stream)
        try:
            yield may
        finally:
            if may:
                with self._lock:
                    self._looking.discard(stream)


class Limits:
    """Counts the requests of clients. Thread-safe.

    rate, burst: most changes of one client in a second, and most at once
    """

    def __init__(self, rate: float = 10.0, burst: int = 20, clock: Callable[[], float] = time.monotonic) -> None:
        self._rate, self._burst, self._clock = rate, burst, clock
        self._lock = threading.Lock()
        self._left: OrderedDict[str, tuple[float, float]] = OrderedDict()
        self._running: Counter[str] = Counter()
        self._changing: Counter[Hashable] = Counter()
        self.look: Final = Looks(LOOKS).look
        """Whether to ask a vehicle for its settings now."""

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
        """Take one of the places for changes that wait for a vehicle. stream: the stream that is changed

        Raises TooManyError if this client or this stream has too many already.
        """
        with self._lock:
            full = self._running[client] >= SLOTS_A_CLIENT or self._running.total() >= SLOTS
            if full or self._changing[stream] >= SLOTS_A_STREAM:
                raise TooManyError("too many requests are waiting for answers of vehicles: try again", 1)
            self._running[client] += 1
            self._changing[stream] += 1
        try:
            yield
        finally:
            with self._lock:
                _one_less(self._running, client)
                _one_less(self._changing, stream)


def _one_less(counter: Counter[Key], key: Key) -> None:
    counter[key] -= 1
    if not counter[key]:
        del counter[key]
