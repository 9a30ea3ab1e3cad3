"""Flight: which messages are under way, and whether the next one may go.

Measured, nothing bounds latency better than one message in flight until its receiver reports arrival: it sees the
buffers of every modem and router further along, which no setting of ours does. With a long round trip
one leaves the link idle, so the number is 1 + round(round-trip time / time to send one).

    reports -> Proofs (which count) -> Followed (whose steer) -> UnderWay (what has arrived) -> PathTimes (what it took)
"""

from __future__ import annotations

import logging
import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from typing import Any

from lidarcodec.apps.publisher.followed import FORGET_S, Followed, Standing, clearly_slower
from lidarcodec.apps.publisher.path_times import LIMIT_S, MAX_IN_FLIGHT, PathTimes
from lidarcodec.apps.publisher.proofs import Proofs
from lidarcodec.apps.publisher.under_way import REMEMBERED, Sent, UnderWay
from lidarcodec.apps.timings import Timings
from lidarcodec.ratecontrol.adaptive import Landing

logger = logging.getLogger(__name__)

WARNED_OF = 64
"""Receivers of which a warning is given that they slow the stream down."""


class Flight:
    """Messages under way to the receiver that is followed. Thread-safe.

    timeouts: messages that went without the report of the one before
    switches: how often another receiver was followed: what was measured before is of another path
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
        self._followed = Followed(follow, clock, max(1.0, 3 * limit_s / FORGET_S), slow_server=slow_server)
        self._slower = SlowerWarning()
        self._proofs, self._under_way, self._path = Proofs(), UnderWay(), PathTimes(limit_s)
        self._given_up_lately: deque[Sent] = deque(maxlen=REMEMBERED)
        self._since_s = clock()
        self.timeouts = self.switches = 0

    @property
    def unreported(self) -> int:
        """Frames of messages that who was followed never reported, though a later one."""
        return self._under_way.unreported

    @property
    def refused(self) -> Counter[str]:
        """Reports that did not count, by why."""
        return self._proofs.refused

    @property
    def arrive_ms(self) -> Timings:
        """Put to report."""
        return self._path.arrive_ms

    # --- receivers --------------------------------------------------------------------------------------------------

    @property
    def following(self) -> str | None:
        """The receiver whose reports count."""
        with self._condition:
            return self._following()

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

    def reported(self, name: str, index: int, checksum: int | None, held_s: float = 0.0) -> None:
        """A receiver has the message, and with it none of those before is under way any more.

        checksum: of the message, as the receiver says; None when it does not
        held_s: how long it kept the report back because its decoder was busy; the path is not to blame for that.
        """
        now = self._clock()
        with self._condition:
            put_s = self._proofs.taken(name, index, checksum, shows_token=name in self._followed)
            if put_s is None:
                return
            self._switch(lambda: self._followed.proved(name, now - put_s))
            sent = self._under_way.find(index)
            if name != self._following() or sent is None:
                return
            self._slower.check(name, self._followed[name].usual_s)
            self._path.arrived(sent, now, self._rtt(name), held_s, late=self._under_way.is_late(index))
            self._under_way.arrived(index, name)
            self._condition.notify_all()

    # --- messages ---------------------------------------------------------------------------------------------------

    @property
    def busy(self) -> bool:
        """Whether a message is under way."""
        return bool(len(self._under_way))

    @property
    def window(self) -> int:
        """How many messages may be under way."""
        with self._condition:
            return self._window()

    def new_codec(self) -> None:
        """The next messages may need a decoder that is not there yet: have patience with their reports."""
        with self._condition:
            self._path.new_codec()

    def sent(
        self, index: int, checksum: int, size: int = 0, frames: int = 1, *, key: bool = False, alone: bool = True
    ) -> None:
        """A message of so many bytes and frames is put now. alone: it needs no other."""
        with self._condition:
            to, now = self._following(), self._clock()
            self._proofs.put(index, checksum, now)
            for old in self._under_way.put(index, Sent(now, size, key, alone, frames, to)):
                self._under_way.missed(old, to or (old.to if old.to in self._followed else None))

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
            return self._condition.wait_for(lambda: not len(self._under_way), timeout_s)

    def wake(self) -> None:
        """Have a `wait` look again."""
        with self._condition:
            self._condition.notify_all()

    # --- what is asked ----------------------------------------------------------------------------------------------

    def landings(self) -> list[Landing]:
        """What the messages took that arrived, or were given up, since this was asked last."""
        with self._condition:
            return self._path.landings()

    def given_up(self) -> list[Sent]:
        """The messages that were given up since this was asked last: nobody knows whether they will arrive."""
        with self._condition:
            given_up = list(self._given_up_lately)
            self._given_up_lately.clear()
            return given_up

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
                "in_flight": len(self._under_way),
                "timeouts": self.timeouts,
                "unreported": self.unreported,
                "refused": dict(self.refused),
                "arrive_ms": self.arrive_ms.summary(),
            }

    # --- with the lock held -----------------------------------------------------------------------------------------

    def _following(self) -> str | None:
        return self._followed.current()[0]

    def _rtt(self, name: str) -> float:
        """The round trip to a receiver: as it says, but no longer than its quickest report took."""
        known = self._followed[name]
        return min(known.rtt_s, *known.took_s) if known.took_s else 0.0

    def _switch(self, change: Callable[[], object]) -> None:
        """Make a change; what is under way to a receiver that is not followed any more is not waited for."""
        before = self._following()
        usual_s = None if before is None else self._followed[before].usual_s
        change()
        if self._following() != before:
            self._since_s = self._clock()
            self._slower.switched(before, usual_s)
            self._under_way.switched()
            self._path.switched()
            self.switches += 1
        self._condition.notify_all()

    def _time_out(self) -> None:
        """The receiver that is followed did not report: the next message goes, and others that do report come first."""
        self.timeouts += 1
        waiting = self._under_way.waiting()
        silent = self._following() if self._path.is_silence(self._path.report_limit_s(waiting)) else None
        self._path.gave_up(waiting, self._clock())
        self._given_up_lately += waiting
        self._under_way.give_up()
        if silent is not None:
            self._switch(lambda: self._followed.silenced(silent))

    def _window(self) -> int:
        following = self._following()
        return self._path.window(0.0 if following is None else self._rtt(following))

    def _may_send(self, most: int) -> bool:
        return self._following() is None or len(self._under_way) < min(self._window(), most)

    def _due(self) -> float:
        """When the oldest message under way has waited long enough."""
        waiting = self._under_way.waiting()
        return min((one.at_s for one in waiting), default=float("-inf")) + self._path.report_limit_s(waiting)


class SlowerWarning:
    """One line when a receiver slows the stream down for the one that was followed before."""

    def __init__(self) -> None:
        self._before: tuple[str, float] | None = None  # who was followed before, and how long its reports took
        self._warned: set[str] = set()

    def switched(self, before: str | None, usual_s: float | None) -> None:
        """Another receiver is followed. before: who was until now; usual_s: how long its reports took, if known."""
        if before is not None and usual_s is not None:
            self._before = before, usual_s

    def check(self, name: str, usual_s: float | None) -> None:
        """A receiver that is followed has reported; usual_s: how long its reports take, if known."""
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
