"""PathTimes: what messages took on the path to the receiver that is followed, and what follows from it: how many may be
under way, and how long a report is waited for."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Final

from lidarcodec.apps.publisher.under_way import Sent
from lidarcodec.apps.timings import Timings, percentile
from lidarcodec.ratecontrol.adaptive import Landing

LIMIT_S: Final = 1.0
"""How long a receiver may leave a message without a report before the next one goes all the same, and another receiver
that does report is followed."""
SOONEST_S, SOONEST_TIMES, KNOWN_REPORTS = 0.3, 4, 8
"""Where so many reports came in less than a quarter of it, a message without one is given up after so long already: a
lost message, or report, then costs three frames and not ten. Each further one in a row doubles it. Not so where
messages need others: a busy receiver would lose what later ones refer to."""
NEW_CODEC_S, NEW_CODEC_MESSAGES = 6.0, 3
"""The same for the first messages of another codec, whose decoder may have to be started: the report of the second one
waits for that, and what went meanwhile would be replaced on the receiver's side, though later messages may need it."""
MAX_IN_FLIGHT: Final = 4
SHORT_PATH_S: Final = 0.010
"""Below this round trip one message in flight leaves no link idle that matters."""
REMEMBERED: Final = 16
SEND_TIMES: Final = 9


class PathTimes:
    """Measures a path. Not thread-safe: `Flight` holds a lock.

    limit_s: how long a message may go without a report; more than LIMIT_S where no frame is to be lost
    arrive_ms: put to report
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
        """The next messages may need a decoder that is not there yet: have patience with their reports."""
        self._patient = NEW_CODEC_MESSAGES

    def arrived(self, sent: Sent, now: float, rtt_s: float, held_s: float, *, late: bool) -> None:
        """A message was reported. held_s: how long its report was kept back; late: it says nothing of the path."""
        self._patient = max(self._patient - 1, 0)
        self._given_up = 0
        self._took_s.append(now - sent.at_s)
        self.arrive_ms.add(1e3 * (now - sent.at_s))
        held_s = min(max(held_s, 0.0), now - sent.at_s)
        free = now - rtt_s - held_s  # when the path was free again, on the publisher's side
        send_s = max(0.0, free - max(sent.at_s, self._last_free))
        self._last_free = max(free, self._last_free)
        if not late:
            self._send_s.append(send_s)
            self._landed(sent, send_s, rtt_s, now)

    def gave_up(self, waiting: Sequence[Sent], now: float) -> None:
        """These messages, oldest first, were not reported in time."""
        self._given_up += 1
        if waiting:  # all of it was under way for as long as the oldest
            all_of_it = waiting[0]._replace(size=sum(one.size for one in waiting))
            self._landed(all_of_it, now - all_of_it.at_s, 0.0, now, landed=False)

    def switched(self) -> None:
        """Another receiver is followed: what was measured is of another path."""
        for times in (self._send_s, self._took_s, self._landings):
            times.clear()
        self._given_up = 0
        self._last_free = float("-inf")

    def landings(self) -> list[Landing]:
        """What the messages took that arrived, or were given up, since this was asked last."""
        landings = list(self._landings)
        self._landings.clear()
        return landings

    def window(self, rtt_s: float) -> int:
        """How many messages may be under way: 1 + round(round trip / time to send one)."""
        send = percentile(sorted(self._send_s), 0.5)
        if self._lossless or rtt_s < SHORT_PATH_S or not send:
            return 1  # of two, one may take the other's place in a receiver's ring
        return min(MAX_IN_FLIGHT, 1 + round(rtt_s / send))

    def report_limit_s(self, waiting: Sequence[Sent]) -> float:
        """How long a report may take. A path that needs long for one gets longer, one that is quick less."""
        usual = percentile(sorted(self._send_s), 0.5) or 0.0
        limit = max(self._limit_s, NEW_CODEC_S if self._patient else 0.0, 3 * usual)
        together = not all(one.alone for one in waiting)  # a receiver that is only busy would lose one
        if together or self._lossless or self._patient or len(self._took_s) < KNOWN_REPORTS:
            return limit
        soon = max(SOONEST_S, SOONEST_TIMES * (percentile(sorted(self._took_s), 0.9) or 0.0))
        return float(min(limit, soon * 2**self._given_up))

    def is_silence(self, limit_s: float) -> bool:
        """Whether a receiver that sent no report for so long counts as silent; sooner, a message or report is lost."""
        return limit_s >= self._limit_s

    def _landed(self, sent: Sent, send_s: float, rtt_s: float, now: float, *, landed: bool = True) -> None:
        since_s = min(now - self._last_landing, LIMIT_S)
        self._last_landing = now
        if sent.size:
            self._landings.append(Landing(8.0 * sent.size, send_s, since_s, rtt_s, sent.key, landed=landed))
