"""SecondLook: when the choice of `codec=auto` is made again, because the machine has become slower or quicker. Pure.

>>> look = SecondLook()
>>> look.decided(now_s=0.0, took_ms=30.0, budget_ms=31.0, best=True)
>>> look.encoded(now_s=1.0, took_ms=90.0)
>>> look.due(now_s=20.0)
False
>>> look.encoded(now_s=41.0, took_ms=90.0)
>>> look.due(now_s=41.0)
True
"""

from __future__ import annotations

from typing import Final

LASTS_S: Final = 10.0
"""How long a codec must have been slower, or quicker, before it counts."""
FIRST_S: Final = 30.0
"""Shortest time from a choice to the next. Each further one waits twice as long, so that no choice flaps."""
MOST_S: Final = 960.0
SLOW: Final = 2.0
"""A codec is too slow if a frame takes so many times the budget: then frames are replaced by newer ones."""
QUICK: Final = 0.5
"""The machine has become quicker if a frame takes this share of the time at which the codec was chosen."""
GAIN: Final = 0.1
"""Weight of a frame in the mean of the last ones."""


class SecondLook:
    """Follows the times of encoding since the last choice. Times are those of one steady clock, in seconds."""

    def __init__(self) -> None:
        self._wait_s = FIRST_S
        self._at_s: float | None = None
        self._took_ms = self._budget_ms = 0.0
        self._best = True
        self._mean_ms: float | None = None
        self._since_s: float | None = None

    def forget(self) -> None:
        """Other settings: there is no choice, and the wait after the next one is the shortest."""
        self._at_s = None

    def decided(self, now_s: float, took_ms: float, budget_ms: float, *, best: bool) -> None:
        """A choice was made. took_ms: time of the chosen codec; best: whether no other one would be better"""
        self._wait_s = FIRST_S if self._at_s is None else min(2.0 * self._wait_s, MOST_S)
        self._at_s = now_s
        self._took_ms, self._budget_ms, self._best = took_ms, budget_ms, best
        self._mean_ms = self._since_s = None

    def encoded(self, now_s: float, took_ms: float) -> None:
        """A frame was encoded with the chosen codec."""
        if self._at_s is None:
            return
        self._mean_ms = took_ms if self._mean_ms is None else self._mean_ms + GAIN * (took_ms - self._mean_ms)
        if not self._changed(self._mean_ms):
            self._since_s = None
        elif self._since_s is None:
            self._since_s = now_s

    def due(self, now_s: float) -> bool:
        """Whether to choose again now."""
        if self._at_s is None or now_s - self._at_s < self._wait_s:
            return False
        if self._took_ms > self._budget_ms:  # none was quick enough: maybe only then
            return True
        return self._since_s is not None and now_s - self._since_s >= LASTS_S

    def _changed(self, mean_ms: float) -> bool:
        return mean_ms > SLOW * self._budget_ms or (not self._best and mean_ms < QUICK * self._took_ms)
