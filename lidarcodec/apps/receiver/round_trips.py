"""RoundTrips: measures the round trip to a publisher, and its clock, with small queries.

An answer may wait behind a large message of the stream. The answer says whether a message was under way. If so, the
measurement is poor, and it is soon repeated.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Final

from lidarcodec.apps.clocks import Clock, LatencyClock
from lidarcodec.untrusted.json import JsonRefusedError, read_object

EVERY_S: Final = 1.0
AGAIN_S: Final = 0.3
"""Interval after an answer that may have waited, or after a clock jump."""
REMEMBERED: Final = 5
QUESTION: Final = b'{"ping":0}'


class RoundTrips:
    """Asks, and remembers the last answers. One thread asks."""

    def __init__(self, clock: Clock, offsets: LatencyClock) -> None:
        self._clock, self._offsets = clock, offsets
        self._free: deque[float] = deque(maxlen=REMEMBERED)
        self._any: deque[float] = deque(maxlen=REMEMBERED)
        self._due_s = self._soonest_s = clock.monotonic_s()

    @property
    def rtt_ms(self) -> float | None:
        """Median of the last round trips without a message under way. If there is none: the shortest of all."""
        if self._free:
            return round(sorted(self._free)[(len(self._free) - 1) // 2], 3)
        return round(min(self._any), 3) if self._any else None

    @property
    def due_s(self) -> float:
        """Monotonic time at which to ask again."""
        return self._due_s

    def hurry(self) -> None:
        """Ask again as soon as allowed."""
        self._due_s = min(self._due_s, self._soonest_s)

    def ask(self, ask: Callable[[bytes], bytes | None]) -> None:
        """Ask once. ask: sends a question and gives its answer, or None."""
        begin_s, asked_ns = self._clock.monotonic_s(), self._clock.wall_ns()
        self._soonest_s, self._due_s = begin_s + AGAIN_S, begin_s + EVERY_S
        answer = ask(QUESTION)
        if answer is None:
            return
        answered_ns, rtt_ms = self._clock.wall_ns(), 1e3 * (self._clock.monotonic_s() - begin_s)
        busy, told_ns = _read(answer)
        (self._any if busy else self._free).append(rtt_ms)
        if busy:
            self._due_s = self._soonest_s
        if told_ns is not None:
            self._offsets.answered(asked_ns, told_ns, answered_ns)


def _read(answer: bytes) -> tuple[bool, int | None]:
    """Whether a message was under way, and the publisher's time in ns.

    An unreadable answer is used only for the round trip.
    """
    try:
        values = read_object(answer)
    except JsonRefusedError:
        return True, None
    told_ns = values.get("time_ns")
    known = isinstance(told_ns, int) and not isinstance(told_ns, bool) and abs(told_ns) < 2**63
    return bool(values.get("busy", False)), told_ns if known else None
