"""Pacing: when a refinement may be sent, so that the next message is not later than without refinements.

It predicts when the link is free, from the bytes that were put and the rate at which they arrive. A sector is sent if
it arrives before the next message is due, less a rest: many links let some bytes pass at once after a rest, and the
next message needs that. How long the rest has to be is measured. Where the link has no room for all sectors, every
ALONE_EVERY-th frame is not refined, and its successor shows how long a message takes alone. If messages that follow
refinements take longer, the rest grows; otherwise it shrinks slowly.

>>> pacing = Pacing()
>>> pacing.message(0.0, 20_000); pacing.message(0.1, 20_000)
>>> pacing.sector_took(0.160, 0.150, 5_000, rtt_s=0.0)     # 5 kB took 10 ms
>>> pacing.fits(0.140, 5_000), pacing.fits(0.155, 5_000)   # the next message is due at 0.2 s, and takes 40 ms
(True, False)
"""

from __future__ import annotations

from collections import deque
from typing import Final

from lidarcodec.apps.timings import percentile

MARGIN: Final = 1.1
"""Times are taken to be so much longer than measured."""
ALONE_EVERY: Final = 8
ROOMY: Final = 3.0
"""A link that was free for so many times of a message before it has room for everything."""
LONGER: Final = 1.1
"""Messages may take so much longer after refinements than alone."""
AGREED: Final = 0.75
"""The percentile that is compared."""
ALONE_KNOWN, BESIDE_KNOWN, REMEMBERED = 3, 8, 24
_GROWS, _SHRINKS, _MOST = 1.5, 0.8, 4.0
_MOST_LOST: Final = 5
_FORGETS: Final = 0.95
"""What a slow sector said counts so much less with each further message: the path may be faster now."""
_SMOOTH, _SLOWER = 0.25, 0.75


class Pacing:
    """Times of one path, in seconds of a monotonic clock. Not thread-safe: `Refining` holds a lock."""

    def __init__(self) -> None:
        self.free_s = float("-inf")
        """When the link will be free, as predicted."""
        self._put_s: float | None = None
        self._interval_s: float | None = None
        self._jitter_s = 0.0  # mean deviation of the interval
        self._size = 0
        self._s_per_byte: float | None = None  # of sectors
        self._of_messages = 0.0  # seconds a byte, too
        self._landed_s = float("-inf")
        self._rest = 1.0  # in times of a message
        self._alone: deque[float] = deque(maxlen=REMEMBERED)
        self._beside: deque[float] = deque(maxlen=BESIDE_KNOWN + 4)
        self._tight = self._without = self._lost = 0
        self._alone_next = False
        self.message_free_s = float("-inf")
        """When the link will have carried the last message, as predicted."""

    @property
    def s_per_byte(self) -> float:
        """Time that the link needs for a byte; 0 if that is not known."""
        return max(self._s_per_byte or 0.0, self._of_messages)

    def message(self, now_s: float, size: int) -> None:
        """A message of `size` bytes is sent."""
        if self._put_s is not None:
            step_s = now_s - self._put_s
            before_s = step_s if self._interval_s is None else self._interval_s
            self._interval_s = before_s + _SMOOTH * (step_s - before_s)
            self._jitter_s += _SMOOTH * (abs(step_s - before_s) - self._jitter_s)
        self._put_s, self._size = now_s, size
        if self._s_per_byte is not None:
            self._s_per_byte *= _FORGETS
        self._alone_next = False
        if now_s - self.free_s < ROOMY * size * self.s_per_byte:
            self._tight += 1
            self._alone_next = self._tight % ALONE_EVERY == 0
        self.free_s = now_s  # what is still under way is short: its prediction may be wrong for longer
        self._takes_link(now_s, size)
        self.message_free_s = self.free_s

    def message_took(self, seconds: float, size: int, s_per_byte: float, *, beside: bool) -> None:
        """A message was reported.

        seconds: from put to report;  s_per_byte: of the last messages, by the path's times
        beside: whether refinements were sent since the message before
        """
        self._of_messages = s_per_byte
        if not size:
            return
        (self._beside if beside else self._alone).append(seconds / size)
        if len(self._alone) < ALONE_KNOWN or not beside:
            return
        usual = percentile(sorted(self._alone), AGREED) or 0.0
        now = percentile(sorted(self._beside), AGREED) or 0.0
        if len(self._beside) >= BESIDE_KNOWN and now > LONGER * usual:
            self._rest = min(_MOST, _GROWS * self._rest + 0.1)
            self._beside.clear()
        elif len(self._beside) == self._beside.maxlen:
            self._rest *= _SHRINKS
            self._beside.clear()

    @property
    def alone(self) -> bool:
        """Whether nothing is sent beside this message, to see how long the next one takes alone."""
        return self._alone_next

    def nothing_fitted(self) -> None:
        """A frame ended without a sector: perhaps the rest is too long."""
        self._without += 1
        if self._without >= ALONE_EVERY:
            self._without, self._rest = 0, _SHRINKS * self._rest

    def sector(self, now_s: float, size: int) -> None:
        """A sector of `size` bytes is sent."""
        self._without = 0
        self._takes_link(now_s, size)

    def sector_took(self, now_s: float, begin_s: float, size: int, rtt_s: float) -> None:
        """A sector was reported now. begin_s: when the link began to carry it, as far as is known"""
        free_s = now_s - rtt_s
        took_s = max(0.0, free_s - max(begin_s, self._landed_s))
        self._landed_s = max(free_s, self._landed_s)
        before, value, self._lost = self._s_per_byte, took_s / size, 0
        if before is None:
            self._s_per_byte = value
        else:
            self._s_per_byte = before + (_SLOWER if value > before else _SMOOTH) * (value - before)

    def sector_lost(self, now_s: float, begin_s: float, size: int) -> None:
        """A sector was not reported until now. The more of them in a row, the longer nothing is sent."""
        self._lost = min(self._lost + 1, _MOST_LOST)
        self._s_per_byte = max(self._s_per_byte or 0.0, 2**self._lost * max(0.0, now_s - begin_s) / size)

    def idle(self, now_s: float) -> None:
        """Nothing is under way now: the link is free, whatever was predicted."""
        self.free_s = min(self.free_s, now_s)

    def fits(self, now_s: float, size: int) -> bool:
        """Whether a sector of `size` bytes, put now, arrives long enough before the next message is due."""
        if self._put_s is None or self._interval_s is None:
            return True
        end_s = max(now_s, self.free_s) + MARGIN * size * self.s_per_byte
        rest_s = min(self._rest * self._size * self.s_per_byte, self._interval_s / 2)
        return end_s + rest_s < self._put_s + self._interval_s - self._jitter_s

    def _takes_link(self, now_s: float, size: int) -> None:
        self.free_s = max(now_s, self.free_s) + size * self.s_per_byte
