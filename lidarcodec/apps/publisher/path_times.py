"""PathTimes: times of messages on the path to the followed receiver. They determine how many messages may be under way,
and the longest wait for a report."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Final

from lidarcodec.apps.publisher.under_way import Sent
from lidarcodec.apps.timings import Timings, percentile
from lidarcodec.ratecontrol.adaptive import Landing

LIMIT_S: Final = 1.0
"""Longest wait for a report. After it the next message is sent anyway, and the publisher follows another receiver that
reports."""
SOONEST_S, SOONEST_TIMES, KNOWN_REPORTS = 0.3, 4, 8
"""The wait is shorter on a fast path: SOONEST_TIMES its usual time, at least SOONEST_S, once there are KNOWN_REPORTS
reports. So a lost message or report costs three frames instead of ten. Each further loss in a row doubles the wait. It
is not shortened for messages that need others, because a busy receiver would lose their references."""
NEW_CODEC_S, NEW_CODEC_MESSAGES = 6.0, 3
"""Longest wait for a report after a change of codec. The receiver may have to start its decoder, which delays the
report of the second message. Messages sent meanwhile would replace each other at the receiver, although later ones may
need them."""
MAX_IN_FLIGHT: Final = 4
SHORT_PATH_S: Final = 0.010
"""Shorter round trips need only one message in flight: the link is idle for a negligible time."""
REMEMBERED: Final = 16
SEND_TIMES: Final = 9


class PathTimes:
    """Measures a path. Not thread-safe: `Flight` holds a lock.

    limit_s: longest wait for a report; longer than LIMIT_S if no frame may be lost
    arrive_ms: times from put to report
    """

    def __init__(self, limit_s: float) -> None:
        self._limit_s, self._lossless = limit_s, limit_s > LIMIT_S
        self._send_s: deque[float] = deque(maxlen=SEND_TIMES)
        self._took_s: deque[float] = deque(maxlen=REMEMBERED)
        self._landings: deque[Landing] = deque(maxlen=REMEMBERED)
        self._last_free = self._last_landing = float("-inf")
        self._patient = self._given_up = 0
        self.arrive_ms = Timings()

    def new_codec(self) -> None:
        """Allow more time for the next reports, as the receiver may have to start a decoder."""
        self._patient = NEW_CODEC_MESSAGES

    def arrived(self, sent: Sent, now: float, rtt_s: float, held_s: float, *, late: bool) -> None:
        """A message was reported. held_s: time the receiver held the report; late: do not use it as a measurement."""
        self._patient = max(self._patient - 1, 0)
        self._given_up = 0
        self._took_s.append(now - sent.at_s)
        self.arrive_ms.add(1e3 * (now - sent.at_s))
        held_s = min(max(held_s, 0.0), now - sent.at_s)
        free = now - rtt_s - held_s  # when the path was free again, by the publisher's clock
        send_s = max(0.0, free - max(sent.at_s, self._last_free))
        self._last_free = max(free, self._last_free)
        if not late:
            self._send_s.append(send_s)
            self._landed(sent, send_s, rtt_s, now)

    def gave_up(self, waiting: Sequence[Sent], now: float) -> None:
        """These messages, oldest first, were not reported in time."""
        self._given_up += 1
        if waiting:  # all of them were under way as long as the oldest
            all_of_it = waiting[0]._replace(size=sum(one.size for one in waiting))
            self._landed(all_of_it, now - all_of_it.at_s, 0.0, now, landed=False)

    def switched(self) -> None:
        """Another receiver is followed: forget the measurements of the previous path."""
        for times in (self._send_s, self._took_s, self._landings):
            times.clear()
        self._given_up = 0
        self._last_free = float("-inf")

    def landings(self) -> list[Landing]:
        """Times of the messages that arrived or were given up since the last call."""
        landings = list(self._landings)
        self._landings.clear()
        return landings

    def window(self, rtt_s: float) -> int:
        """How many messages may be under way: 1 + round(round trip / time to send one)."""
        send = percentile(sorted(self._send_s), 0.5)
        if self._lossless or rtt_s < SHORT_PATH_S or not send:
            return 1  # a second one could replace the first in the receiver's ring
        return min(MAX_IN_FLIGHT, 1 + round(rtt_s / send))

    def report_limit_s(self, waiting: Sequence[Sent]) -> float:
        """Longest wait for a report in seconds: longer on slow paths, shorter on fast ones."""
        usual = percentile(sorted(self._send_s), 0.5) or 0.0
        limit = max(self._limit_s, NEW_CODEC_S if self._patient else 0.0, 3 * usual)
        together = not all(one.alone for one in waiting)  # otherwise a busy receiver would lose one of them
        if together or self._lossless or self._patient or len(self._took_s) < KNOWN_REPORTS:
            return limit
        soon = max(SOONEST_S, SOONEST_TIMES * (percentile(sorted(self._took_s), 0.9) or 0.0))
        return float(min(limit, soon * 2**self._given_up))

    def is_silence(self, limit_s: float) -> bool:
        """Whether a receiver counts as silent after this wait. After a shorter wait only a message or report was
        lost.
        """
        return limit_s >= self._limit_s

    def _landed(self, sent: Sent, send_s: float, rtt_s: float, now: float, *, landed: bool = True) -> None:
        since_s = min(now - self._last_landing, LIMIT_S)
        self._last_landing = now
        if sent.size:
            self._landings.append(Landing(8.0 * sent.size, send_s, since_s, rtt_s, sent.key, landed=landed))
