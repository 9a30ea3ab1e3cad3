"""PathTimes: times of messages on the path to the followed receiver. They determine how many messages may be under way,
and the longest wait for a report.

The wait for a report is the usual time from put to report and twice its mean deviation. (RFC 6298 waits for four of
them before TCP sends again. Here the next message is due anyway, and one that was not lost is not sent again.) A
message that is overdue by then may be lost, or wait in a queue of the path. So the next one may take longer by the time
that the path needs for both.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from typing import Final, NamedTuple

from lidarcodec.apps.publisher.under_way import Sent
from lidarcodec.apps.timings import Timings, percentile
from lidarcodec.ratecontrol.adaptive import Landing

LIMIT_S: Final = 1.0
"""Longest silence of a receiver. After it the next message is sent anyway, and the publisher follows another receiver
that reports."""
DEVIATIONS, LEAST_S, KNOWN_REPORTS = 2.0, 0.03, 8
"""Once there are KNOWN_REPORTS reports, the wait for one is shorter than LIMIT_S: the usual time and DEVIATIONS times
its mean deviation, at least LEAST_S, which a busy receiver may need."""
NEW_CODEC_S, NEW_CODEC_MESSAGES = 6.0, 3
"""Longest wait for a report after a change of codec. The receiver may have to start its decoder, which delays the
report of the second message. Messages sent meanwhile would replace each other at the receiver, although later ones may
need them."""
MAX_IN_FLIGHT: Final = 4
SHORT_PATH_S: Final = 0.010
"""Shorter round trips need only one message in flight: the link is idle for a negligible time."""
REMEMBERED: Final = 16
SEND_TIMES: Final = 9


class Took(NamedTuple):
    """Seconds from put to report of the message of frame `frame` and `size` bytes, without the time for which the
    receiver held it."""

    frame: int
    seconds: float
    size: int


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
        self._patient = 0
        self._s_per_byte: deque[float] = deque(maxlen=SEND_TIMES)
        self._sizes: deque[int] = deque(maxlen=SEND_TIMES)
        self._took: deque[Took] = deque(maxlen=REMEMBERED)
        self.arrive_ms = Timings()

    def new_codec(self) -> None:
        """Allow more time for the next reports, as the receiver may have to start a decoder."""
        self._patient = NEW_CODEC_MESSAGES

    def arrived(self, sent: Sent, now: float, rtt_s: float, held_s: float, *, late: bool) -> None:
        """A message was reported. held_s: time the receiver held the report; late: do not use it as a measurement."""
        self._patient = max(self._patient - 1, 0)
        self._took_s.append(now - sent.at_s)
        self.arrive_ms.add(1e3 * (now - sent.at_s))
        held_s = min(max(held_s, 0.0), now - sent.at_s)
        free = now - rtt_s - held_s  # when the path was free again, by the publisher's clock
        send_s = max(0.0, free - max(sent.at_s, self._last_free))
        self._last_free = max(free, self._last_free)
        if not late:
            self._took.append(Took(sent.index, now - sent.at_s - held_s, sent.size))
            self._send_s.append(send_s)
            if sent.size:
                self._s_per_byte.append(send_s / sent.size)
                self._sizes.append(sent.size)
            self._landed(sent, send_s, rtt_s, now)

    def gave_up(self, waiting: Sequence[Sent], now: float) -> None:
        """The receiver is silent: these messages, oldest first, were not reported."""
        if waiting:  # all of them were under way as long as the oldest
            all_of_it = replace(waiting[0], size=sum(one.size for one in waiting))
            self._landed(all_of_it, now - all_of_it.at_s, 0.0, now, landed=False)

    def switched(self) -> None:
        """Another receiver is followed: forget the measurements of the previous path."""
        for values in (self._send_s, self._took_s, self._landings, self._s_per_byte, self._sizes, self._took):
            values.clear()
        self._last_free = float("-inf")

    def landings(self) -> list[Landing]:
        """Times of the messages that arrived or were given up since the last call."""
        landings = list(self._landings)
        self._landings.clear()
        return landings

    def took(self) -> list[Took]:
        """Times from put to report of the messages that were reported since the last call."""
        took = list(self._took)
        self._took.clear()
        return took

    def s_per_byte(self) -> float:
        """Time that the path needs for a byte; 0 if that is not known."""
        return percentile(sorted(self._s_per_byte), 0.5) or 0.0

    def window(self, rtt_s: float, parts: int = 1) -> int:
        """How many turns may be under way: 1 + round(round trip / time to send one). parts: messages of a turn"""
        send = percentile(sorted(self._send_s), 0.5)
        if self._lossless or rtt_s < SHORT_PATH_S or not send:
            return 1  # a second one could replace the first in the receiver's ring
        return min(MAX_IN_FLIGHT, 1 + round(rtt_s / (send * parts)))

    def silence_s(self) -> float:
        """After so many seconds without a report a receiver counts as silent."""
        usual = percentile(sorted(self._send_s), 0.5) or 0.0
        return max(self._limit_s, NEW_CODEC_S if self._patient else 0.0, 3 * usual)

    def report_limit_s(self, size: int, ahead: int = 0) -> float:
        """Longest wait for the report of a message of `size` bytes, in seconds.

        ahead: bytes of overdue messages, which may still be on the path
        """
        silence = self.silence_s()
        if self._lossless or self._patient or len(self._took_s) < KNOWN_REPORTS:
            return silence
        usual = percentile(sorted(self._took_s), 0.5) or 0.0
        deviation = sum(abs(one - usual) for one in self._took_s) / len(self._took_s)
        more = max(0, size + ahead - (percentile(sorted(self._sizes), 0.5) or 0))
        return min(silence, usual + max(DEVIATIONS * deviation, LEAST_S) + more * self.s_per_byte())

    def _landed(self, sent: Sent, send_s: float, rtt_s: float, now: float, *, landed: bool = True) -> None:
        since_s = min(now - self._last_landing, LIMIT_S)
        self._last_landing = now
        if sent.size:
            self._landings.append(Landing(8.0 * sent.size, send_s, since_s, rtt_s, sent.key, landed=landed))
