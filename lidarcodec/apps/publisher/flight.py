"""Flight: which messages are under way, and whether the next one may go.

Measured, nothing bounds latency better than one message in flight until its receiver reports arrival: it sees the
buffers of every modem and router further along, which no setting of ours does. With a long round trip
one leaves the link idle, so the number is 1 + round(round-trip time / time to send one).

Who is followed is told by `Followed`. A report counts once for each receiver and message, and only when the receiver
shows a token, the message was sent lately, and the report repeats its checksum.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import Counter, OrderedDict, deque
from collections.abc import Callable
from typing import Any, NamedTuple

from lidarcodec.apps.publisher.followed import FORGET_S, Followed, Standing, clearly_slower
from lidarcodec.apps.timings import Timings, percentile
from lidarcodec.ratecontrol.adaptive import Landing

logger = logging.getLogger(__name__)

LIMIT_S = 1.0
"""How long a receiver may leave a message without a report before the next one goes all the same, and another receiver
that does report is followed."""
SOONEST_S, SOONEST_TIMES, KNOWN_REPORTS = 0.3, 4, 8
"""Where so many reports came in less than a quarter of it, a message without one is given up after so long already: a
lost message, or report, then costs three frames and not ten. Each further one in a row doubles it. Not so where
messages need others: a busy receiver would lose what later ones refer to."""
NEW_CODEC_S, NEW_CODEC_MESSAGES = 6.0, 3
"""The same for the first messages of another codec, whose decoder may have to be started: the report of the second one
waits for that, and what went meanwhile would be replaced on the receiver's side, though later messages may need it."""
MAX_IN_FLIGHT = 4
SHORT_PATH_S = 0.010
"""Below this round trip one message in flight leaves no link idle that matters."""
REMEMBERED = 16
PROOFS = 64
"""Messages that can be reported: those of some seconds, which may wait in front of a slow link."""
WARNED_OF = 64
"""Receivers of which a warning is given that they slow the stream down."""
REFUSED = ("no_token", "not_sent", "wrong_checksum", "repeated")
"""Why a report does not count."""


class Sent(NamedTuple):
    """A message that was put: when, how large, whether a key frame, whether it can be decoded without others, of how
    many frames, and who was followed."""

    at_s: float
    size: int
    key: bool
    alone: bool
    frames: int
    to: str | None


class Proof(NamedTuple):
    """What proves that a message was received: its checksum; with it when it was put, and who has reported it."""

    at_s: float
    checksum: int
    by: set[str]


class Flight:
    """Messages under way to the receiver that is followed. Thread-safe.

    timeouts: messages that went without the report of the one before; arrive_ms: put to report
    unreported: frames of messages that who was followed never reported, though a later one; they were lost on the way,
                or a later one took their place in the receiver's ring
    switches: how often another receiver was followed: what was measured before is of another path
    refused: reports that did not count, by why
    """

    def __init__(
        self,
        follow: str | None = None,
        clock: Callable[[], float] = time.monotonic,
        limit_s: float = LIMIT_S,
        *,
        slow_server: bool = True,
    ) -> None:
        """limit_s: how long a message may go without a report;  slow_server: as for `Followed`"""
        self._condition = threading.Condition()
        self._clock = clock
        self._limit_s, self._lossless = limit_s, limit_s > LIMIT_S
        self._followed = Followed(follow, clock, max(1.0, 3 * limit_s / FORGET_S), slow_server=slow_server)
        self._since_s = clock()
        self._before: tuple[str, float] | None = None  # who was followed before, and how long its reports took
        self._warned: set[str] = set()
        self._sent: OrderedDict[int, Sent] = OrderedDict()
        self._proofs: OrderedDict[int, Proof] = OrderedDict()
        self._late: set[int] = set()  # were given up: when they arrive after all they say nothing of the path
        self._landings: deque[Landing] = deque(maxlen=REMEMBERED)
        self._given_up_lately: deque[Sent] = deque(maxlen=REMEMBERED)
        self._open: set[int] = set()
        self._last_free = self._last_landing = float("-inf")
        self._send_s: list[float] = []
        self._patient = self._given_up = 0
        self._took_s: deque[float] = deque(maxlen=REMEMBERED)  # from put to report
        self.timeouts = self.switches = self.unreported = 0
        self.refused: Counter[str] = Counter(dict.fromkeys(REFUSED, 0))
        self.arrive_ms = Timings()

    @property
    def following(self) -> str | None:
        """The receiver whose reports count."""
        with self._condition:
            return self._following()

    @property
    def busy(self) -> bool:
        """Whether a message is under way."""
        return bool(self._open)

    @property
    def receivers(self) -> list[str]:
        """Those that have proved that they receive."""
        with self._condition:
            return self._followed.names()

    def standing(self, name: str) -> Standing:
        """How much is to be given on what somebody says under a name."""
        with self._condition:
            return self._followed.standing(name)

    def follow(self, name: str | None) -> None:
        """Follow this receiver when it is there; None: the server, else the first."""
        with self._condition:
            self._switch(lambda: setattr(self._followed, "named", name))

    def came(self, name: str) -> None:
        """A receiver that will report is there."""
        with self._condition:
            self._switch(lambda: self._followed.came(name))

    def went(self, name: str) -> None:
        """A receiver is gone."""
        with self._condition:
            self._switch(lambda: self._followed.went(name))

    def round_trip(self, name: str, rtt_s: float) -> None:
        """What a receiver measured as the round trip; no report of its can have come sooner."""
        with self._condition:
            if name in self._followed and 0.0 <= rtt_s <= 10.0:
                self._followed[name].rtt_s = rtt_s
                self._condition.notify_all()

    def new_codec(self) -> None:
        """The next messages may need a decoder that is not there yet: have patience with their reports."""
        with self._condition:
            self._patient = NEW_CODEC_MESSAGES

    def sent(
        self, index: int, checksum: int, size: int = 0, frames: int = 1, *, key: bool = False, alone: bool = True
    ) -> None:
        """A message of so many bytes and frames is put now. alone: it needs no other."""
        with self._condition:
            to, now = self._following(), self._clock()
            self._sent[index] = Sent(now, size, key, alone, frames, to)
            self._proofs[index] = Proof(now, checksum, set())
            while len(self._sent) > REMEMBERED:
                oldest, sent = next(iter(self._sent.items()))
                self._forget(oldest, to or (sent.to if sent.to in self._followed else None))
            while len(self._proofs) > PROOFS:
                self._proofs.popitem(last=False)
            if to is not None:
                self._open.add(index)

    def reported(self, name: str, index: int, checksum: int | None, held_s: float = 0.0) -> None:
        """A receiver has the message, and with it none of those before is under way any more.

        checksum: of the message, as the receiver says; None when it does not
        held_s: how long it kept the report back because its decoder was busy; the path is not to blame for that.
        """
        now = self._clock()
        with self._condition:
            refused = self._why_not(name, index, checksum)
            if refused is not None:
                self.refused[refused] += 1
                return
            self._proofs[index].by.add(name)
            self._switch(lambda: self._followed.proved(name, now - self._proofs[index].at_s))
            if name != self._following() or index not in self._sent:
                return
            sent = self._sent[index]
            self._warn_if_slower(name)
            self._patient = max(self._patient - 1, 0)
            self._given_up = 0
            self._took_s.append(now - sent.at_s)
            self.arrive_ms.add(1e3 * (now - sent.at_s))
            rtt = self._rtt(name)
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
        """For the status: who reports, who is followed and why, and what is under way."""
        with self._condition:
            following, why = self._followed.current()
            return {
                **self._followed.state(),
                "following": following,
                "because": None if following is None else why,
                "for_s": None if following is None else round(self._clock() - self._since_s, 1),
                "window": self._window(),
                "in_flight": len(self._open),
                "timeouts": self.timeouts,
                "unreported": self.unreported,
                "refused": dict(self.refused),
                "arrive_ms": self.arrive_ms.summary(),
            }

    def _why_not(self, name: str, index: int, checksum: int | None) -> str | None:
        """Why a report does not count; None: it does."""
        if name not in self._followed:
            return "no_token"
        proof = self._proofs.get(index)
        if proof is None:
            return "not_sent"
        if checksum != proof.checksum:
            return "wrong_checksum"
        return "repeated" if name in proof.by else None

    def _rtt(self, name: str) -> float:
        """The round trip to a receiver: as it says, but no longer than its quickest report took."""
        known = self._followed[name]
        return min(known.rtt_s, *known.took_s) if known.took_s else 0.0

    def _warn_if_slower(self, name: str) -> None:
        """One line when somebody slows the stream down for those who were followed before."""
        usual_s = self._followed[name].usual_s
        if usual_s is None or self._before is None:
            return
        before, before_s = self._before
        self._before = None
        if before == name or name in self._warned or len(self._warned) >= WARNED_OF:
            return
        if not clearly_slower(usual_s, before_s):
            return
        self._warned.add(name)
        logger.warning(
            "the stream now waits for receiver %s, which slows it down: its reports take %.2f s, those of %s took "
            "%.2f s; to change that, set follow=%s",
            *(name, usual_s, before, before_s, before),
        )

    def _forget(self, index: int, missed_by: str | None) -> None:
        """A message is not waited for any more; missed_by: who did not report it, though a later one."""
        sent = self._sent.pop(index)
        self._open.discard(index)
        self._late.discard(index)
        if sent.to is not None and sent.to == missed_by:
            self.unreported += sent.frames

    def _following(self) -> str | None:
        return self._followed.current()[0]

    def _switch(self, change: Callable[[], object]) -> None:
        """Make a change; what is under way to a receiver that is not followed any more is not waited for."""
        before = self._following()
        usual_s = None if before is None else self._followed[before].usual_s
        change()
        if self._following() != before:
            self._since_s = self._clock()
            if before is not None and usual_s is not None:
                self._before = before, usual_s
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
            self._switch(lambda: self._followed.silenced(silent))
        self._open.clear()

    def _window(self) -> int:
        following = self._following()
        rtt = 0.0 if following is None else self._rtt(following)
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
