"""Freshness: which frames are too old to show. They are still decoded, because later frames may need them.

>>> fresh = Freshness(1.0, patient=True)
>>> [fresh.shows(age_ms, now_s) for age_ms, now_s in ((90, 0.0), (9000, 9.0), (8000, 9.01), (100, 9.1))]
[True, False, False, True]
>>> [fresh.shows(3000, 10.0 + second) for second in range(3)]  # on a path that is always slow, old frames are shown
[False, True, True]
"""

from __future__ import annotations

from typing import Final, Literal

LIVE_S: Final = 2.0
"""Largest age of a frame in a live view. A codec that codes ten frames together already delays them by a second."""
PATIENCE_S: Final = 1.0
"""If only old frames have come for this long, an old frame is shown."""
MaxAge = float | Literal["live"] | None


class Freshness:
    """Decides for each frame whether to show it.

    max_age_s: None shows all frames; patient: show old frames if no others come
    """

    def __init__(self, max_age_s: float | None, *, patient: bool = False) -> None:
        self.max_age_s, self._patient = max_age_s, patient
        self._old_since: float | None = None

    @classmethod
    def of(cls, max_age_s: MaxAge, *, newest: bool) -> Freshness:
        """`live`: at most two seconds old, if only the newest frame is wanted; otherwise all frames."""
        if max_age_s == "live":
            return cls(LIVE_S if newest else None, patient=True)
        return cls(max_age_s)

    def shows(self, age_ms: float | None, now_s: float) -> bool:
        """Whether to show a frame of that age, None: unknown; now_s: monotonic time."""
        if self.max_age_s is None or age_ms is None or age_ms <= 1e3 * self.max_age_s:
            self._old_since = None
            return True
        if self._old_since is None:
            self._old_since = now_s
        return self._patient and now_s - self._old_since >= PATIENCE_S


class OnlyBehind:
    """Detects that for PATIENCE_S only frames with lower numbers than the newest have come: the newest was wrong.

    Without this, one message with a far too high number (forged, or by a fault) would hide all following frames.

    >>> behind = OnlyBehind()
    >>> [behind.lasts(index, now_s) for index, now_s in ((3, 0.0), (4, 0.6), (5, 1.2), (6, 1.3))]
    [False, False, True, False]
    """

    def __init__(self) -> None:
        self._since: float | None = None
        self._index = 0

    def lasts(self, index: int, now_s: float) -> bool:
        """Take a lower number; returns whether such numbers have come for PATIENCE_S, in ascending order."""
        if self._since is None or index <= self._index:
            self._since = now_s
        self._index = index
        if now_s - self._since < PATIENCE_S:
            return False
        self._since = None
        return True

    def over(self) -> None:
        """A frame with a higher number came: start again."""
        self._since = None


class Forward:
    """Keeps a live view from going back in time, as networks may repeat or reorder messages.

    >>> view, s = Forward(), 10**9
    >>> came = ((7, 10, 30 * s), (7, 11, 31 * s), (7, 3, 23 * s), (7, 12, 32 * s))
    >>> [view.goes_back(*frame, 0.0) for frame in came]
    [False, False, True, False]
    >>> view.goes_back(6, 99, 2 * s, 0.5), view.goes_back(8, 0, 33 * s, 0.5)  # an earlier run; the next one
    (True, False)
    """

    def __init__(self) -> None:
        self._stream_id: int | None = None
        self._index = self._stamp_ns = 0
        self._shown_s = float("-inf")
        self._behind = OnlyBehind()

    def goes_back(self, stream_id: int | None, index: int, stamp_ns: int, now_s: float) -> bool:
        """Whether not to show a frame, because a later one of its stream was shown, or it is from an earlier run.

        stamp_ns: host time of the frame; now_s: monotonic time. If it refuses all frames for long, it accepts them
        again.
        """
        if stream_id == self._stream_id:
            back = index < self._index and not self._behind.lasts(index, now_s)
        else:
            back = now_s - self._shown_s < PATIENCE_S and self._stamp_ns - stamp_ns > LIVE_S * 1e9
        if back:
            return True
        self._stream_id, self._index, self._stamp_ns, self._shown_s = stream_id, index, stamp_ns, now_s
        self._behind.over()
        return False
