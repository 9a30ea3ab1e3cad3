"""Gaps: when the link is free between live messages, and how many bytes fit into what is left of a gap.

It predicts when the link has carried what was put, by the rate at which live messages arrive, and when the next live
message is due. On a path with a short round trip a gap begins with the report of the message. On others it begins when
the link is free as predicted; a report that is late ends it. On a short path, small parts go until the next message
is there.

>>> gaps = Gaps()
>>> gaps.message(0.0, 20_000); gaps.message(0.1, 20_000)
>>> gaps.arrived(0.14, 2e-6, free=True)
>>> gaps.room(0.14, 64_000, busy=False, rtt_s=0.001)    # 60 ms are left, 5 of them rest
(0.0, 24999)
>>> gaps.room(0.145, 64_000, busy=False, rtt_s=0.001)[1]    # that part takes until 0.18 s
0
"""

from __future__ import annotations

from typing import Final

from lidarcodec.apps.publisher.path_times import SHORT_PATH_S

MARGIN: Final = 1.1
"""Parts are taken to need so much longer than messages of that size."""
REST_S: Final = 0.005
"""The link is free for so long before a message is due."""
LEAST: Final = 4096
"""Smaller gaps are left alone."""
LATE_S: Final = 0.02
"""A report is late when it comes so long after its predicted time."""
_STOPPED: Final = 3.0
_SMOOTH: Final = 0.25


class Gaps:
    """Times are in seconds of a monotonic clock. Not thread-safe: `Flight` holds a lock.

    free_s: when the link will have carried what was put, as predicted
    """

    def __init__(self) -> None:
        self.free_s = self._message_free_s = float("-inf")
        self._put_s: float | None = None
        self._interval_s: float | None = None
        self._jitter_s = self._s_per_byte = 0.0

    def message(self, now_s: float, size: int) -> None:
        """A live message of `size` bytes is sent."""
        if self._put_s is not None:
            step_s = now_s - self._put_s
            before_s = step_s if self._interval_s is None else self._interval_s
            self._interval_s = before_s + _SMOOTH * (step_s - before_s)
            self._jitter_s += _SMOOTH * (abs(step_s - before_s) - self._jitter_s)
        self._put_s = now_s
        self.take(now_s, size)
        self._message_free_s = self.free_s

    def arrived(self, now_s: float, s_per_byte: float, *, free: bool) -> None:
        """A live message was reported. s_per_byte: of the path;  free: no other one is under way"""
        self._s_per_byte = s_per_byte
        if free:
            self.free_s = min(self.free_s, now_s)

    def take(self, now_s: float, size: int) -> None:
        """So many bytes are sent, whatever they are."""
        self.free_s = max(now_s, self.free_s) + size * self._s_per_byte

    def room(self, now_s: float, most: int, *, busy: bool, rtt_s: float, least: int = 0) -> tuple[float, int] | None:
        """How long to wait, and how many bytes to send if that is 0; they are taken. None: it is not known.

        most: bytes that are wanted;  busy: a live message is under way
        least: bytes that may go on a short path although the next message is due: that is later by so much
        """
        put_s, interval_s, s_per_byte = self._put_s, self._interval_s, self._s_per_byte
        if put_s is None or interval_s is None or not s_per_byte or now_s - put_s > _STOPPED * interval_s:
            return None
        due_s = put_s + interval_s - self._jitter_s
        if busy and (rtt_s < SHORT_PATH_S or now_s > self._message_free_s + rtt_s + LATE_S):
            return max(due_s - now_s, REST_S), 0
        short = rtt_s < SHORT_PATH_S
        begin_s = now_s if short and self.free_s - now_s < LATE_S else max(now_s, self.free_s)
        size = max(int((due_s - REST_S - begin_s) / (MARGIN * s_per_byte)), least if short else 0)
        if size < min(LEAST, most):
            return max(due_s - now_s, REST_S), 0
        if begin_s > now_s:
            return begin_s - now_s, 0
        size = min(size, most)
        self.take(now_s, size)
        return 0.0, size
