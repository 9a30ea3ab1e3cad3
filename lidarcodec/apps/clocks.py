"""Clocks: offset of a publisher's clock from ours. Its error is at most half a round trip, even after clock jumps.

A receiver asks a publisher for its time, and notes the times of question and answer. The publisher read its clock
between these two times (Cristian's algorithm, 1989). The answer with the shortest round trip has the smallest error.
All waiting uses the monotonic clock, so a jump of a host's clock delays nothing. It only makes latencies unknown until
the next answer.

>>> offset = ClockOffset()
>>> offset.answered(asked_ns=1_000_000, told_ns=6_000_000, answered_ns=3_000_000, monotonic_s=0.0)
>>> offset.offset_ms(0.0), offset.bound_ms(0.0)
(4.0, 1.0)
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any, Final, NamedTuple

LIMIT_MS: Final = 60_000.0
"""Latencies above this or below -1 s are discarded: they come from a recording or from clocks that differ."""
JUMP_MS: Final = 250.0
"""A larger change between two readings is a jump: slewing a clock is slower."""
DRIFT: Final = 1e-4
"""Largest drift between two clocks: 0.1 ms a second, twice that of a bad quartz."""
REMEMBERED: Final = 8


class Clock(NamedTuple):
    """The clocks of a machine. wall_ns: host time since the Unix epoch, may jump; monotonic_s: never jumps."""

    wall_ns: Callable[[], int] = time.time_ns
    monotonic_s: Callable[[], float] = time.monotonic


SYSTEM: Final = Clock()


class _Answer(NamedTuple):
    offset_ms: float
    bound_ms: float
    at_s: float


class ClockOffset:
    """The publisher's clock minus ours. Not thread-safe.

    jumps: number of jumps of either clock
    """

    def __init__(self) -> None:
        self._answers: deque[_Answer] = deque(maxlen=REMEMBERED)
        self._ours: tuple[int, float] | None = None
        self.jumps = 0

    def look(self, wall_ns: int, monotonic_s: float) -> None:
        """Give it the present time of our own clocks. A jump of the host's clock changes the offset by the same
        amount.
        """
        if self._ours is not None:
            gone_ms = (wall_ns - self._ours[0]) / 1e6 - 1e3 * (monotonic_s - self._ours[1])
            if abs(gone_ms) > JUMP_MS:
                self.jumps += 1
                moved = [answer._replace(offset_ms=answer.offset_ms - gone_ms) for answer in self._answers]
                self._answers = deque(moved, REMEMBERED)
        self._ours = wall_ns, monotonic_s

    def answered(self, asked_ns: int, told_ns: int, answered_ns: int, monotonic_s: float) -> None:
        """Take an answer: time of the question, the publisher's time, and time of arrival."""
        self.look(answered_ns, monotonic_s)
        bound_ms = (answered_ns - asked_ns) / 2e6
        if bound_ms < 0.0:
            return  # our clock was set back in between
        new = _Answer((told_ns - (asked_ns + answered_ns) / 2) / 1e6, bound_ms, monotonic_s)
        best = self._best(monotonic_s)
        if best is not None:
            apart = abs(new.offset_ms - best.offset_ms) - bound_ms - self._bound(best, monotonic_s)
            if apart > 0.0:  # both cannot be right: the publisher's clock was set
                self.jumps += apart > JUMP_MS
                self._answers.clear()
        self._answers.append(new)

    def forget(self) -> None:
        """Forget the answers, because the publisher's clock jumped or the publisher changed."""
        self._answers.clear()

    def offset_ms(self, monotonic_s: float) -> float | None:
        """The publisher's clock minus ours; None before the first answer."""
        best = self._best(monotonic_s)
        return None if best is None else best.offset_ms

    def bound_ms(self, monotonic_s: float) -> float | None:
        """Largest error of `offset_ms`: half of the round trip, plus drift since; None before the first answer."""
        best = self._best(monotonic_s)
        return None if best is None else self._bound(best, monotonic_s)

    def _best(self, monotonic_s: float) -> _Answer | None:
        return min(self._answers, key=lambda answer: self._bound(answer, monotonic_s), default=None)

    @staticmethod
    def _bound(answer: _Answer, monotonic_s: float) -> float:
        return answer.bound_ms + 1e3 * DRIFT * max(monotonic_s - answer.at_s, 0.0)


class LatencyClock:
    """Latencies from a publisher's stamps to our time, also when clocks jump. Thread-safe.

    unsure: called when a stamp shows that a clock jumped, so that the offset must be asked for again
    """

    def __init__(self, clock: Clock = SYSTEM, unsure: Callable[[], object] = lambda: None) -> None:
        self._clock, self.unsure = clock, unsure
        self._lock = threading.Lock()
        self._offset = ClockOffset()
        self._last: tuple[float, float] | None = None
        self._distrust = False

    def answered(self, asked_ns: int, told_ns: int, answered_ns: int) -> None:
        """Take a publisher's answer to a question for its time."""
        with self._lock:
            self._offset.answered(asked_ns, told_ns, answered_ns, self._clock.monotonic_s())
            self._distrust = False
            self._last = None

    def restarted(self) -> None:
        """Another publisher sends from here on, maybe on another machine."""
        with self._lock:
            self._offset.forget()
            self._last, self._distrust = None, False

    def latency_ms(self, last_ns: int, now_ns: int) -> float | None:
        """Time from a publisher's stamp to `now_ns`, corrected if the clocks certainly differ; None if unknown."""
        with self._lock:
            now_s = self._clock.monotonic_s()
            self._offset.look(now_ns, now_s)
            value = (now_ns - last_ns) / 1e6 + self._correction(now_s)
            jumped = self._jumped(value, now_s)
            self._last = value, now_s
            if jumped:
                self._offset.jumps += not self._distrust
                self._offset.forget()
                self._distrust = True
            unknown = self._distrust or not -1000.0 < value < LIMIT_MS
        if jumped:
            self.unsure()
        return None if unknown else value

    def state(self) -> dict[str, Any]:
        """`offset_ms`: the publisher's clock minus ours; `bound_ms`: its largest error; both null before the first
        answer. `state`: `in step` (equal within the error), `corrected` (in the latencies), or `unknown`; `jumps`."""
        with self._lock:
            now_s = self._clock.monotonic_s()
            offset, bound = self._offset.offset_ms(now_s), self._offset.bound_ms(now_s)
            state = "unknown" if offset is None else "corrected" if self._correction(now_s) else "in step"
            return {
                "state": state,
                "offset_ms": None if offset is None else round(offset, 3),
                "bound_ms": None if bound is None else round(bound, 3),
                "jumps": self._offset.jumps,
            }

    def _correction(self, now_s: float) -> float:
        offset, bound = self._offset.offset_ms(now_s), self._offset.bound_ms(now_s)
        return 0.0 if offset is None or bound is None or abs(offset) <= bound else offset

    def _jumped(self, value: float, now_s: float) -> bool:
        """Whether the publisher's clock was set. It was set back if latency grew by more than the time since the last
        frame, and set ahead if a stamp is in the future."""
        if self._offset.offset_ms(now_s) is not None and value < -JUMP_MS:
            return True
        if self._last is None:
            return False
        return value - self._last[0] > 1e3 * (now_s - self._last[1]) + JUMP_MS
