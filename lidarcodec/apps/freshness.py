"""Freshness: which frames are too old to be shown. They are decoded all the same, because later ones may need them.

>>> fresh = Freshness(1.0, patient=True)
>>> [fresh.shows(age_ms, now_s) for age_ms, now_s in ((90, 0.0), (9000, 9.0), (8000, 9.01), (100, 9.1))]
[True, False, False, True]
>>> [fresh.shows(3000, 10.0 + second) for second in range(3)]  # a path that is always so slow is shown none the less
[False, True, True]
"""

from __future__ import annotations

from typing import Final, Literal

LIVE_S: Final = 2.0
"""Age above which a live view leaves a frame out. A codec that codes ten frames together is a second late by itself."""
PATIENCE_S: Final = 1.0
"""When only old frames have come for so long, an old frame is better than none."""
MaxAge = float | Literal["live"] | None


class Freshness:
    """Says of each frame whether it is to be shown.

    max_age_s: None shows all; patient: show old frames when nothing else comes
    """

    def __init__(self, max_age_s: float | None, *, patient: bool = False) -> None:
        self.max_age_s, self._patient = max_age_s, patient
        self._old_since: float | None = None

    @classmethod
    def of(cls, max_age_s: MaxAge, *, newest: bool) -> Freshness:
        """`live`: two seconds, but patient, for whoever wants the newest; all frames for whoever wants every one."""
        if max_age_s == "live":
            return cls(LIVE_S if newest else None, patient=True)
        return cls(max_age_s)

    def shows(self, age_ms: float | None, now_s: float) -> bool:
        """Whether to show a frame of that age, None when nobody knows it; now_s: monotonic time."""
        if self.max_age_s is None or age_ms is None or age_ms <= 1e3 * self.max_age_s:
            self._old_since = None
            return True
        if self._old_since is None:
            self._old_since = now_s
        return self._patient and now_s - self._old_since >= PATIENCE_S


class Forward:
    """Keeps a live view from going back: a path may send a message once more, or change the order of messages.

    >>> view = Forward()
    >>> [view.goes_back(stream_id, index) for stream_id, index in ((7, 10), (7, 11), (7, 3), (7, 12), (8, 0))]
    [False, False, True, False, False]
    """

    def __init__(self) -> None:
        self._newest: tuple[int | None, int] = None, 0

    def goes_back(self, stream_id: int | None, index: int) -> bool:
        """Whether a later frame of the same stream came before this one, which must not be shown then."""
        if stream_id == self._newest[0] and index < self._newest[1]:
            return True
        self._newest = stream_id, index
        return False
