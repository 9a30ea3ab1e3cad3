"""Flight: which messages are under way, and whether the next one may go.

Measured, nothing bounds latency better than one message in flight until its receiver reports arrival: it sees the
buffers of every modem and router further along, which no setting of ours does (ECOSYSTEM 1.4). With a long round trip
one leaves the link idle, so the number is 1 + round(round-trip time / time to send one).
"""

from __future__ import annotations

import threading
import time
from collections import OrderedDict, deque
from collections.abc import Callable
from typing import Any, NamedTuple

from lidarcodec.apps.timings import Timings, percentile
from lidarcodec.ratecontrol.adaptive import Landing
from lidarcodec.transport.keys import SERVER_RECEIVER

LIMIT_S = 1.0
"""How long a receiver may leave a message without a report before the next one goes all the same, and another receiver
that does report is followed."""
SOONEST_S, SOONEST_TIMES, KNOWN_REPORTS = 0.3, 4, 8
"""Where so many reports came in less than a quarter of it, a message without one is given up after so long already: a
lost message, or report, then costs three frames and not ten. Each further one in a row doubles it. Not so where
messages need others: a busy receiver would lose what later ones refer to."""
FORGET_S = 10.0
"""A receiver without a liveliness token that reported nothing for so long is gone."""
NEW_CODEC_S, NEW_CODEC_MESSAGES = 6.0, 3
"""The same for the first messages of another codec, whose decoder may have to be started: the report of the second one
waits for that, and what went meanwhile would be replaced on the receiver's side, though later messages may need it."""
MAX_IN_FLIGHT = 4
SHORT_PATH_S = 0.010
"""Below this round trip one message in flight leaves no link idle that matters."""
REMEMBERED = 16
MAX_RECEIVERS = 64


class Sent(NamedTuple):
    """A message that was put: when, how large, whether a key frame, whether it can be decoded without others, of how
    many frames, and who was followed."""

    at_s: float
    size: int
    key: bool
    alone: bool = True
    frames: int = 1
    to: str | None = None


class Flight:
    """Messages under way to the receiver that is followed: the one that is named, else the server, else the first that
    came; another one while that one is silent. Thread-safe.

    timeouts: messages that went without the report of the one before; arrive_ms: put to report
    unreported: frames of messages that who was followed never reported, though a later one; they were lost on the way,
                or a later one took their place in the receiver's ring
    switches: how often another receiver was followed: what was measured before is of another path
    """

    def __init__(
        self, follow: str | None = None, clock: Callable[[], float] = time.monotonic, limit_s: float = LIMIT_S
    ) -> None:
        self._condition = threading.Condition()
        self._clock = clock
        self._follow, self._limit_s, self._lossless = follow, limit_s, limit_s > LIMIT_S
        self._alive: OrderedDict[str, float | None] = OrderedDict()  # None: has a token; else time of the last report
        self._sent: OrderedDict[int, Sent] = OrderedDict()
        self._late: set[int] = set()  # were given up: when they arrive after all they say nothing of the path
        self._landings: deque[Landing] = deque(maxlen=REMEMBERED)
        self._given_up_lately: deque[Sent] = deque(maxlen=REMEMBERED)
        self._open: set[int] = set()
        self._silent: set[str] = set()  # did not report in time; followed again when they report
        self._last_free = self._last_landing = float("-inf")
        self._send_s: list[float] = []
        self._rtt_s: dict[str, float] = {}
        self._patient = self._given_up = 0
        self._took_s: deque[float] = deque(maxlen=REMEMBERED)  # from put to report
        self.timeouts = self.switches = self.unreported = 0
        self.arrive_ms = Timings()

    @property
    def following(self) -> str | None:
        """The receiver whose reports count: the one that was named, else the server, else the first that came."""
        with self._condition:
            return self._following()

    @property
    def busy(self) -> bool:
        """Whether a message is under way."""
        return bool(self._open)

    @property
    def receivers(self) -> list[str]:
        """Those that report."""
        with self._condition:
            return list(self._alive)

    def follow(self, name: str | None) -> None:
        """Follow this receiver when it is there; None: the server, else the first."""
        with self._condition:
            self._switch(lambda: setattr(self, "_follow", name))

    def came(self, name: str) -> None:
        """A receiver that will report is there."""
        with self._condition:
            if name in self._alive or len(self._alive) < MAX_RECEIVERS:
                self._switch(lambda: self._alive.__setitem__(name, None))

    def went(self, name: str) -> None:
        """A receiver is gone."""
        with self._condition:
            self._rtt_s.pop(name, None)
            self._silent.discard(name)
            self._switch(lambda: self._alive.pop(name, None))

    def round_trip(self, name: str, rtt_s: float) -> None:
        """What a receiver measured as the round trip."""
        with self._condition:
            if name in self._alive and 0.0 <= rtt_s <= 10.0:
                self._rtt_s[name] = rtt_s
                self._condition.notify_all()

    def new_codec(self) -> None:
        """The next messages may need a decoder that is not there yet: have patience with their reports."""
        with self._condition:
            self._patient = NEW_CODEC_MESSAGES

    def sent(self, index: int, size: int = 0, frames: int = 1, *, key: bool = False, alone: bool = True) -> None:
        """A message of so many bytes and frames is put now. alone: it needs no other."""
        with self._condition:
            to = self._following()
            self._sent[index] = Sent(self._clock(), size, key, alone, frames, to)
            while len(self._sent) > REMEMBERED:
                self._forget(next(iter(self._sent)), to)
            if to is not None:
                self._open.add(index)

    def reported(self, name: str, index: int, held_s: float = 0.0) -> None:
        """A receiver has the message, and with it none of those before is under way any more.

        held_s: how long it kept the report back because its decoder was busy; the path is not to blame for that.
        """
        now = self._clock()
        with self._condition:
            self._switch(lambda: self._silent.discard(name))
            if self._alive.get(name, now) is not None:  # no token: known by its reports only
                if name not in self._alive and len(self._alive) >= MAX_RECEIVERS:
                    return
                self._alive[name] = now
            if name != self._following() or index not in self._sent:
                return
            sent, self._patient = self._sent[index], max(self._patient - 1, 0)
            self._given_up = 0
            self._took_s.append(now - sent.at_s)
            self.arrive_ms.add(1e3 * (now - sent.at_s))
            rtt = self._rtt_s.get(name, 0.0)
            held_s = min(max(held_s, 0.0), now - sent.at_s)
            free = now - rtt - held_s  # when the path was free again, on the publisher's side
            send_s = max(0.0, free - max(sent.at_s, self._last_free))
            self._last_free = max(free, self._last_free)
            if index not in self._late:
                self._send_s = [*self._send_s[-8:], send_s]
                self._landed(sent, send_s, rtt, now)
            self._forget(index, None)
            for one in [one for one in self._sent if one < index]:
                self._forget(one, name)
            self._condition.notify_all()

    def landings(self) -> list[Landing]:
        """What the messages took that arrived, or were given up, since this was asked last."""
        with self._condition:
            landings = list(self._landings)
            self._landings.clear()
            return landings

    def given_up(self) -> list[Sent]:
        """The messages that were given up since this was asked last: nobody knows whether they will arrive."""
        with self._condition:
            given_up = list(self._given_up_lately)
            self._given_up_lately.clear()
            return given_up

    @property
    def window(self) -> int:
        """How many messages may be under way."""
        with self._condition:
            return self._window()

    def wait(self, timeout_s: float, most: int = MAX_IN_FLIGHT) -> bool:
        """Whether the next message may go, as one of so many under way; waits for a report until then, at most
        `timeout_s`."""
        end = self._clock() + timeout_s
        with self._condition:
            while not self._may_send(most):
                left = min(end, self._due()) - self._clock()
                if left <= 0:
                    if self._due() <= self._clock():
                        self._time_out()
                        return True
                    return False
                self._condition.wait(left)
            return True

    def wait_landed(self, timeout_s: float) -> bool:
        """Whether everything that was sent has arrived; waits for it, at most `timeout_s`."""
        with self._condition:
            return self._condition.wait_for(lambda: not self._open, timeout_s)

    def wake(self) -> None:
        """Have a `wait` look again."""
        with self._condition:
            self._condition.notify_all()

    def state(self) -> dict[str, Any]:
        """For the status: who reports, who is followed, and what is under way."""
        with self._condition:
            return {
                "receivers": list(self._alive),
                "following": self._following(),
                "window": self._window(),
                "in_flight": len(self._open),
                "timeouts": self.timeouts,
                "unreported": self.unreported,
                "arrive_ms": self.arrive_ms.summary(),
            }

    def _forget(self, index: int, missed_by: str | None) -> None:
        """A message is not waited for any more; missed_by: who did not report it, though a later one."""
        sent = self._sent.pop(index)
        self._open.discard(index)
        self._late.discard(index)
        if sent.to is not None and sent.to == missed_by:
            self.unreported += sent.frames

    def _following(self) -> str | None:
        now = self._clock()
        for name in [n for n, last in self._alive.items() if last is not None and now - last > FORGET_S]:
            del self._alive[name]
        heard = [name for name in self._alive if name not in self._silent] or list(self._alive)
        for wanted in (self._follow, SERVER_RECEIVER):
            if wanted in heard:
                return wanted
        return heard[0] if heard else None

    def _switch(self, change: Callable[[], object]) -> None:
        """Make a change; what is under way to a receiver that is not followed any more is not waited for."""
        before = self._following()
        change()
        if self._following() != before:
            self._open.clear()
            self._send_s.clear()
            self._took_s.clear()
            self._given_up = 0
            self._landings.clear()
            self._last_free = float("-inf")
            self._late.update(self._sent)
            self.switches += 1
        self._condition.notify_all()

    def _landed(self, sent: Sent, send_s: float, rtt_s: float, now: float, *, landed: bool = True) -> None:
        since_s = min(now - self._last_landing, LIMIT_S)
        self._last_landing = now
        if sent.size:
            self._landings.append(Landing(8.0 * sent.size, send_s, since_s, rtt_s, sent.key, landed=landed))

    def _time_out(self) -> None:
        """The receiver that is followed did not report: the next message goes, and others that do report come first."""
        self.timeouts += 1
        now = self._clock()
        silent = self._following() if self._limit() >= self._limit_s else None
        self._given_up += 1
        waiting = [self._sent[one] for one in sorted(self._open)]
        if waiting:  # all of it was under way for as long as the oldest
            all_of_it = waiting[0]._replace(size=sum(one.size for one in waiting))
            self._landed(all_of_it, now - all_of_it.at_s, 0.0, now, landed=False)
        self._given_up_lately += waiting
        self._late.update(self._open)
        if silent is not None:
            self._switch(lambda: self._silent.add(silent))
        self._open.clear()

    def _window(self) -> int:
        rtt = self._rtt_s.get(self._following() or "", 0.0)
        send = percentile(sorted(self._send_s), 0.5)
        if self._lossless or rtt < SHORT_PATH_S or not send:
            return 1  # of two, one may take the other's place in a receiver's ring
        return min(MAX_IN_FLIGHT, 1 + round(rtt / send))

    def _may_send(self, most: int) -> bool:
        return self._following() is None or len(self._open) < min(self._window(), most)

    def _due(self) -> float:
        """When the oldest message under way has waited long enough."""
        return min((self._sent[one].at_s for one in self._open), default=float("-inf")) + self._limit()

    def _limit(self) -> float:
        """How long a message may take; a path that needs long for one gets longer, one that is quick less."""
        usual = percentile(sorted(self._send_s), 0.5) or 0.0
        limit = max(self._limit_s, NEW_CODEC_S if self._patient else 0.0, 3 * usual)
        together = not all(self._sent[one].alone for one in self._open)  # a receiver that is only busy would lose one
        if together or self._lossless or self._patient or len(self._took_s) < KNOWN_REPORTS:
            return limit
        soon = max(SOONEST_S, SOONEST_TIMES * (percentile(sorted(self._took_s), 0.9) or 0.0))
        return float(min(limit, soon * 2**self._given_up))
