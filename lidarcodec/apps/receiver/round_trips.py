"""RoundTrips: the time to a publisher and back, and its clock, from small questions beside a stream of large messages.

An answer that met a message on its way waited for it. The publisher says whether one was under way; what it answered
then tells little, and is asked again soon.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Final

from lidarcodec.apps.clocks import Clock, LatencyClock
from lidarcodec.untrusted.json import JsonRefusedError, read_object

EVERY_S: Final = 1.0
AGAIN_S: Final = 0.3
"""After an answer that had to wait, or when a clock was seen to jump."""
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
        """The usual one of the last round trips that met no message; as long as there is none, the shortest of all."""
        if self._free:
            return round(sorted(self._free)[(len(self._free) - 1) // 2], 3)
        return round(min(self._any), 3) if self._any else None

    @property
    def due_s(self) -> float:
        """Monotonic time at which to ask again."""
        return self._due_s

    def hurry(self) -> None:
        """Ask again as soon as may be."""
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

    An answer that cannot be read counts as an answer only.
    """
    try:
        values = read_object(answer)
    except JsonRefusedError:
        return True, None
    told_ns = values.get("time_ns")
    known = isinstance(told_ns, int) and not isinstance(told_ns, bool) and abs(told_ns) < 2**63
    return bool(values.get("busy", False)), told_ns if known else None
