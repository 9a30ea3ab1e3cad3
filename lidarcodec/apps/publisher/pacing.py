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
_TRIED: Final = 0.5
"""The same after ALONE_EVERY frames without a sector."""
_SMOOTH, _SLOWER = 0.25, 0.75
PAUSE_S: Final = 1.0
"""So long a time between two messages, if it is not usual, is a pause of the sensor or a cut of the link."""


class Pacing:
    """Times of one path, in seconds of a monotonic clock. Not thread-safe: `Refining` holds a lock."""

    def __init__(self) -> None:
        self._put_s: float | None = None
        self._interval_s: float | None = None
        self._jitter_s = 0.0  # mean deviation of the interval
        self._paused = False
        self._since_s = float("-inf")  # when the last pause ended
        self._size = 0
        self.new_path()

    def new_path(self) -> None:
        """Another receiver is followed: forget what was learned of the path, but not when messages are due."""
        self.free_s = float("-inf")
        """When the link will be free, as predicted."""
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
            self._step(now_s, now_s - self._put_s)
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
        """A frame ended without a sector: perhaps the rest is too long, or the path is faster again."""
        self._without += 1
        if self._without >= ALONE_EVERY:
            self._without, self._rest = 0, _SHRINKS * self._rest
            if self._s_per_byte is not None:
                self._s_per_byte *= _TRIED

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

    def sectors_lost(self, now_s: float, begin_s: float, size: int) -> None:
        """Sectors of a frame were not reported until now. The more such frames in a row, the longer nothing is sent.

        begin_s, size: of the first of them. It counts as no longer under way than an interval of messages, for what
        followed may be a cut. What was under way before a pause does not count.
        """
        if begin_s < self._since_s:
            return
        took_s = max(0.0, now_s - begin_s)
        if self._interval_s is not None:
            took_s = min(took_s, self._interval_s)
        self._s_per_byte = max(self._s_per_byte or 0.0, 2**self._lost * took_s / size)
        self._lost = min(self._lost + 1, _MOST_LOST)

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

    def _step(self, now_s: float, step_s: float) -> None:
        """Learn the interval of messages. A pause tells nothing of it, but two in a row do."""
        usual_s = self._interval_s
        if usual_s is not None and step_s > max(PAUSE_S, ROOMY * usual_s):
            self._since_s = now_s
            if not self._paused:
                self._paused = True
                return
            usual_s = None
        self._paused = False
        if usual_s is None or ROOMY * step_s < usual_s > PAUSE_S:
            self._interval_s, self._jitter_s = step_s, 0.0
        else:
            self._interval_s = usual_s + _SMOOTH * (step_s - usual_s)
            self._jitter_s += _SMOOTH * (abs(step_s - usual_s) - self._jitter_s)

    def _takes_link(self, now_s: float, size: int) -> None:
        self.free_s = max(now_s, self.free_s) + size * self.s_per_byte
