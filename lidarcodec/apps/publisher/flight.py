"""Flight: the messages under way, and whether the next one may be sent.

Only one message is in flight until its receiver reports the arrival. This bounds latency even when modems and routers
on the path have large buffers, which no local setting can limit. With a long round trip one message would leave the
link idle, so the number of messages is 1 + round(round-trip time / time to send one). The parts of a turn count as one:
they do not wait for each other.

A message counts as lost when a later report says that it is missing. When its own report is overdue, the next one is
sent; `given_up` tells which messages that must not need. A receiver that reports nothing for a second is silent: then
each message waits for a second, and another receiver may be followed.

reports -> Proofs (which reports count) -> Followed (which receiver controls) -> UnderWay (which messages arrived)
-> PathTimes (how long they took)
"""

from __future__ import annotations

import logging
import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from typing import Any

from lidarcodec.apps.publisher.followed import FORGET_S, Followed, Standing, clearly_slower
from lidarcodec.apps.publisher.gaps import Gaps
from lidarcodec.apps.publisher.path_times import LIMIT_S, MAX_IN_FLIGHT, PathTimes, Took
from lidarcodec.apps.publisher.proofs import PROOFS, Proofs
from lidarcodec.apps.publisher.under_way import REMEMBERED, Landed, Sent, UnderWay
from lidarcodec.apps.timings import Timings
from lidarcodec.ratecontrol.adaptive import Landing

logger = logging.getLogger(__name__)

WARNED_OF = 64
"""Most receivers for which the warning of a slow receiver is logged."""


class Flight:
    """Messages under way to the receiver that is followed. Thread-safe.

    timeouts: messages whose report was overdue when the next one was due
    switches: number of changes of the followed receiver
    """

    def __init__(
        self,
        follow: str | None = None,
        clock: Callable[[], float] = time.monotonic,
        limit_s: float = LIMIT_S,
        *,
        slow_server: bool = True,
    ) -> None:
        """limit_s: longest wait for a report;  slow_server: as in `Followed`"""
        self._condition = threading.Condition()
        self._clock = clock
        self._followed = Followed(follow, clock, max(1.0, 3 * limit_s / FORGET_S), slow_server=slow_server)
        self._slower = SlowerWarning()
        self._proofs, self._under_way, self._path = Proofs(), UnderWay(), PathTimes(limit_s)
        self._gaps = Gaps()
        self._doubtful: dict[int, Sent] = {}
        self._arrived: deque[int] = deque(maxlen=PROOFS)
        self._quiet_s: float | None = None  # when the oldest message was sent since the last report
        self._silent = False
        self._since_s = clock()
        self._parts = self._part = 1  # messages of the last whole turn, and so far of this one
        self.timeouts = self.switches = 0

    @property
    def unreported(self) -> int:
        """Frames of messages that the followed receiver never reported although it reported a later one."""
        return self._under_way.unreported

    @property
    def refused(self) -> Counter[str]:
        """Number of reports that did not count, by reason."""
        return self._proofs.refused

    @property
    def arrive_ms(self) -> Timings:
        """Times from put to report, in ms."""
        return self._path.arrive_ms

    # --- receivers --------------------------------------------------------------------------------------------------

    @property
    def following(self) -> str | None:
        """The receiver whose reports count."""
        with self._condition:
            return self._following()

    @property
    def receivers(self) -> list[str]:
        """Receivers that have proved that they receive."""
        with self._condition:
            return self._followed.names()

    def standing(self, name: str) -> Standing:
        """How far messages under this name can be trusted."""
        with self._condition:
            return self._followed.standing(name)

    def follow(self, name: str | None) -> None:
        """Follow this receiver while it is connected. None: follow the server, or without a server the first
        receiver.
        """
        with self._condition:
            self._switch(lambda: setattr(self._followed, "named", name))

    def came(self, name: str) -> None:
        """A receiver has declared its token: it will report."""
        with self._condition:
            self._switch(lambda: self._followed.came(name))

    def went(self, name: str) -> None:
        """A receiver has left."""
        with self._condition:
            self._switch(lambda: self._followed.went(name))

    def round_trip(self, name: str, rtt_s: float) -> None:
        """Set the round trip that a receiver measured. The time of its fastest report limits it."""
        with self._condition:
            if name in self._followed and 0.0 <= rtt_s <= 10.0:
                self._followed[name].rtt_s = rtt_s
                self._condition.notify_all()

    def reported(
        self,
        name: str,
        index: int,
        checksum: int | None,
        held_s: float = 0.0,
        has: Callable[[int], bool] = lambda _: False,
    ) -> None:
        """A receiver reported a message. The message and all earlier ones are no longer under way.

        checksum: of the message, in the report; None if it has none
        held_s: time for which the receiver held the report because its decoder was busy; not part of the path's time
        has: whether an earlier message arrived there, by its index
        """
        now = self._clock()
        with self._condition:
            put_s = self._proofs.taken(name, index, checksum, shows_token=name in self._followed)
            if put_s is None:
                return
            self._switch(lambda: self._followed.proved(name, now - put_s))
            if name != self._following():
                return
            self._doubtful.pop(index, None)
            self._arrived.append(index)
            sent = self._under_way.find(index)
            if sent is None:
                return
            self._slower.check(name, self._followed[name].usual_s)
            self._path.arrived(sent, now, self._rtt(name), held_s, late=self._under_way.is_late(index))
            self._take(self._under_way.arrived(index, name, has))
            self._gaps.arrived(now, self._path.s_per_byte(), free=not len(self._under_way))
            self._quiet_s = min((one.at_s for one in self._under_way.unresolved(name)), default=None)
            self._silent = False
            self._condition.notify_all()

    # --- messages ---------------------------------------------------------------------------------------------------

    @property
    def busy(self) -> bool:
        """Whether a message is under way."""
        return bool(len(self._under_way))

    @property
    def window(self) -> int:
        """Largest number of messages under way."""
        with self._condition:
            return self._window()

    @property
    def rtt_s(self) -> float | None:
        """Round trip to the followed receiver; None if nobody is followed."""
        with self._condition:
            name = self._following()
            return None if name is None else self._rtt(name)

    def new_codec(self) -> None:
        """Allow more time for the next reports, as the receiver may have to start a decoder."""
        with self._condition:
            self._path.new_codec()

    def sent(
        self, index: int, checksum: int, size: int = 0, frames: int = 1, *, key: bool = False, turn: int | None = None
    ) -> None:
        """A message of `size` bytes and `frames` frames is sent now. turn: index of the first part of its turn"""
        with self._condition:
            to, now = self._following(), self._clock()
            if turn is None or turn == index:
                self._parts, self._part = self._part, 1
            else:
                self._part += 1
            self._proofs.put(index, checksum, now)
            self._gaps.message(now, size)
            for old in self._under_way.put(Sent(index, now, size, key, frames, to, index if turn is None else turn)):
                self._under_way.missed(old, to or (old.to if old.to in self._followed else None))
            if to is not None and self._quiet_s is None:
                self._quiet_s = now

    def room(self, most: int, least: int) -> tuple[float, int] | None:
        """As `Gaps.room`, for something else than live messages."""
        with self._condition:
            name = self._following()
            rtt_s = 0.0 if name is None else self._rtt(name)
            return self._gaps.room(self._clock(), most, busy=self.busy, rtt_s=rtt_s, least=least)

    def beside(self, size: int) -> None:
        """So many bytes are sent beside live messages, and not by `room`."""
        with self._condition:
            self._gaps.take(self._clock(), size)

    @property
    def taken_s(self) -> float:
        """For how long the link is taken by what was put, as predicted; 0 if it is free."""
        with self._condition:
            return max(0.0, self._gaps.free_s - self._clock())

    def wait(self, timeout_s: float, most: int = MAX_IN_FLIGHT) -> bool:
        """Wait until the next message may be sent, at most `timeout_s`; returns whether it may.

        most: largest number of messages under way
        """
        end = self._clock() + timeout_s
        with self._condition:
            while True:
                self._give_up(self._clock())
                if self._may_send(most):
                    return True
                left = min(end, self._due()) - self._clock()
                if left <= 0:
                    return False
                self._condition.wait(left)

    def wait_landed(self, timeout_s: float) -> bool:
        """Wait until all messages have arrived, at most `timeout_s`; returns whether they have."""
        with self._condition:
            return self._condition.wait_for(lambda: not len(self._under_way), timeout_s)

    def wake(self) -> None:
        """Make `wait` check again."""
        with self._condition:
            self._condition.notify_all()

    # --- queries ----------------------------------------------------------------------------------------------------

    def landings(self) -> list[Landing]:
        """Times of the messages that arrived or were given up since the last call."""
        with self._condition:
            return self._path.landings()

    def took(self) -> list[Took]:
        """Times from put to report of the messages that were reported since the last call."""
        with self._condition:
            return self._path.took()

    def waited_for(self) -> tuple[int, float] | None:
        """The oldest message under way: its bytes, and the seconds since it was sent, less the round trip. None if
        there is none."""
        with self._condition:
            name = self._following()
            unresolved = [] if name is None else self._under_way.unresolved(name)
            if name is None or not unresolved:
                return None
            return unresolved[0].size, self._clock() - unresolved[0].at_s - self._rtt(name)

    @property
    def s_per_byte(self) -> float:
        """Time that the path needs for a byte of a message; 0 if that is not known."""
        with self._condition:
            return self._path.s_per_byte()

    def given_up(self) -> list[Sent]:
        """The messages that became overdue or known as lost since the last call. An overdue one may still arrive."""
        with self._condition:
            self._give_up(self._clock())
            given_up = list(self._doubtful.values())
            self._doubtful.clear()
            return given_up

    def arrivals(self) -> list[int]:
        """Indices of the messages that the followed receiver has received, as was learned since the last call."""
        with self._condition:
            arrived = list(self._arrived)
            self._arrived.clear()
            return arrived

    def state(self) -> dict[str, Any]:
        """For the status: reporting receivers, the followed one and why, and messages under way."""
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
        """The round trip that a receiver measured, limited by the time of its fastest report."""
        known = self._followed[name]
        return min(known.rtt_s, *known.took_s) if known.took_s else 0.0

    def _switch(self, change: Callable[[], object]) -> None:
        """Make a change. If another receiver is followed afterwards, stop waiting for messages under way."""
        before = self._following()
        usual_s = None if before is None else self._followed[before].usual_s
        change()
        if self._following() != before:
            self._since_s = self._clock()
            self._slower.switched(before, usual_s)
            self._under_way.give_up()
            self._path.switched()
            self._quiet_s, self._silent = None, False
            self._arrived.clear()
            self.switches += 1
        self._condition.notify_all()

    def _give_up(self, now: float) -> None:
        """Stop waiting for messages whose report is overdue, and for all of a receiver that is silent: then prefer
        receivers that report.
        """
        due = [one for one in self._under_way.waiting() if now >= self._due_at(one)]
        self.timeouts += len(due)
        for one in due:
            self._under_way.overdue(one.index)
        quiet = self._quiet_s is not None and now - self._quiet_s >= self._path.silence_s()
        falls_silent = bool(due) and quiet and not self._silent
        name = self._following()
        if falls_silent or (self._silent and due):
            self._silent = True
            self._path.gave_up(self._under_way.unresolved(name) if falls_silent else due, now)
            due += self._under_way.waiting()
            self._under_way.give_up()
        self._doubt(due)
        if falls_silent and name is not None:
            self._switch(lambda: self._followed.silenced(name))

    def _take(self, landed: Landed) -> None:
        for one in landed.arrived:
            self._doubtful.pop(one.index, None)
            self._arrived.append(one.index)
        self._doubt(landed.lost)

    def _doubt(self, sent: list[Sent]) -> None:
        self._doubtful |= {one.index: one for one in sent}
        while len(self._doubtful) > REMEMBERED:
            self._doubtful.pop(next(iter(self._doubtful)))

    def _window(self) -> int:
        following = self._following()
        return self._path.window(0.0 if following is None else self._rtt(following), self._parts)

    def _may_send(self, most: int) -> bool:
        return self._following() is None or self._under_way.turns < min(self._window(), most)

    def _due(self) -> float:
        """Time at which the next message under way is given up."""
        return min((self._due_at(one) for one in self._under_way.waiting()), default=float("inf"))

    def _due_at(self, sent: Sent) -> float:
        if self._silent:
            return sent.at_s + self._path.silence_s()
        overdue = [one for one in self._under_way.unresolved(sent.to) if not self._under_way.is_open(one.index)]
        ahead = sum(one.size for one in overdue if one.index < sent.index)
        return sent.at_s + self._path.report_limit_s(sent.size, ahead)


class SlowerWarning:
    """Logs a warning when the followed receiver is slower than the one followed before."""

    def __init__(self) -> None:
        self._before: tuple[str, float] | None = None  # name and usual report time of the receiver followed before
        self._warned: set[str] = set()

    def switched(self, before: str | None, usual_s: float | None) -> None:
        """The followed receiver changed. before: the previous one; usual_s: its usual report time, if known."""
        if before is not None and usual_s is not None:
            self._before = before, usual_s

    def check(self, name: str, usual_s: float | None) -> None:
        """The followed receiver has reported; usual_s: its usual report time, if known."""
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
            "the stream now waits for receiver %s, which is slower: its reports take %.2f s, those of %s took "
            "%.2f s. To wait for the faster one, set follow=%s",
            *(name, usual_s, before, before_s, before),
        )
