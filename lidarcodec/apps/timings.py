"""Timings: durations in bounded memory. A histogram since the start, percentiles over the newest values.

>>> timings = Timings()
>>> for value in (1.0, 2.0, 30.0):
...     timings.add(value)
>>> summary = timings.summary()
>>> summary["count"], summary["p50"], summary["max"]
(3, 2.0, 30.0)
"""

from __future__ import annotations

import threading
from bisect import bisect_left
from collections import deque
from typing import Any

BOUNDS_MS = (1.0, 2.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 40.0, 50.0, 75.0, 100.0, 150.0, 200.0, 300.0, 500.0, 1000.0)
"""Upper bounds of the histogram's buckets; longer durations are in one more bucket."""
RECENT = 600
"""Number of newest values for percentiles: a minute at 10 Hz."""


def percentile(values: list[float], q: float) -> float | None:
    """The value that a share `q` of the values does not exceed; None for an empty list. values: sorted"""
    return values[min(len(values) - 1, int(q * len(values)))] if values else None


class Timings:
    """Durations in milliseconds. Thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._recent: deque[float] = deque(maxlen=RECENT)
        self._buckets = [0] * (len(BOUNDS_MS) + 1)
        self._count, self._sum, self._max = 0, 0.0, 0.0

    def add(self, value_ms: float) -> None:
        """Add a duration."""
        with self._lock:
            self._recent.append(value_ms)
            self._buckets[bisect_left(BOUNDS_MS, value_ms)] += 1
            self._count += 1
            self._sum += value_ms
            self._max = max(self._max, value_ms) if self._count > 1 else value_ms

    def recent(self) -> list[float]:
        """The newest values, in order."""
        with self._lock:
            return list(self._recent)

    def histogram(self) -> tuple[list[int], float]:
        """Counts by bucket, of BOUNDS_MS and beyond, and the sum of all, since the start."""
        with self._lock:
            return list(self._buckets), round(self._sum, 3)

    def summary(self, *, buckets: bool = False) -> dict[str, Any]:
        """count, mean and max since the start; p50 and p99 of the newest values; sum and histogram if wanted."""
        with self._lock:
            values = sorted(self._recent)
            out: dict[str, Any] = {
                "count": self._count,
                "mean": round(self._sum / self._count, 3) if self._count else None,
                "p50": _rounded(percentile(values, 0.5)),
                "p99": _rounded(percentile(values, 0.99)),
                "max": round(self._max, 3) if self._count else None,
            }
            if buckets:
                out["sum"] = round(self._sum, 3)
                out["buckets"] = {f"{bound:g}": n for bound, n in zip(BOUNDS_MS, self._buckets, strict=False)}
                out["buckets"]["more"] = self._buckets[-1]
            return out


class MeanRate:
    """Frames a second over all the time in which they came: from the first to the last. Not thread-safe.

    >>> rate = MeanRate()
    >>> for at_s in (5.0, 5.5, 6.0, 9.0):
    ...     rate.add(at_s)
    >>> rate.fps
    0.75
    """

    def __init__(self) -> None:
        self._first_s: float | None = None
        self._last_s = 0.0
        self._after = 0

    def add(self, at_s: float, frames: int = 1) -> None:
        """Count frames that came at a time of the monotonic clock. Those of the first time begin the count."""
        if self._first_s is None:
            self._first_s = at_s
        else:
            self._after += frames
        self._last_s = at_s

    @property
    def fps(self) -> float | None:
        """The rate; None before a second frame came."""
        if self._first_s is None or not self._after:
            return None
        return round(self._after / max(self._last_s - self._first_s, 1e-6), 2)


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 3)
