"""Allowance: a rate limit for all clients together.

>>> clock = [0.0]
>>> allowance = Allowance(rate=2.0, burst=1, clock=lambda: clock[0])
>>> allowance.take(), allowance.take()
(0.0, 0.5)
>>> clock[0] = 0.5; allowance.take()
0.0
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable


class Allowance:
    """A token bucket. Thread-safe."""

    def __init__(self, rate: float, burst: int, clock: Callable[[], float] = time.monotonic) -> None:
        """rate: times a second;  burst: times at once"""
        self._rate, self._burst, self._clock = rate, burst, clock
        self._lock = threading.Lock()
        self._left, self._at_s = float(burst), clock()

    def take(self, number: int = 1) -> float:
        """Take `number` tokens and return 0; or take none and return the seconds until they are there.

        number: at most `burst`
        """
        with self._lock:
            now = self._clock()
            self._left = min(float(self._burst), self._left + self._rate * (now - self._at_s))
            self._at_s = now
            if self._left >= number:
                self._left -= number
                return 0.0
            return (number - self._left) / self._rate
