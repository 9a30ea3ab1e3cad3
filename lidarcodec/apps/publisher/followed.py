"""Followed: the receiver whose arrival reports control a publisher, and the reason.

A receiver shows its presence with a liveliness token. It controls the stream only after it has proved that it receives:
with a report that has the index and the checksum of a recent message. Only programs that received the message know its
checksum. The publisher waits briefly for a receiver without proof, and only while no other receiver has a proof.
"""

from __future__ import annotations

import time
from collections import OrderedDict, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal

from lidarcodec.apps.timings import percentile
from lidarcodec.transport.keys import SERVER_RECEIVER

MAX_RECEIVERS = 256
"""Most receivers that are remembered. Beyond that, those with the least evidence are dropped."""
LISTED = 64
"""Most receivers in the status."""
FORGET_S, UNPROVED_S = 10.0, 3.0
"""After this time without a report the publisher does not wait for a receiver until it reports again. This holds for
its first report, too."""
MEASURED, ENOUGH = 8, 4
"""Number of newest reports that determine a receiver's usual time, and the least number."""
SLOWER_TIMES, SLOWER_S = 1.5, 0.03
"""A receiver is clearly slower than another one if its time is longer by this factor and by this difference. At 10 Hz
a message that fits the path takes about 65 ms. One slow receiver must not lower the quality of the others."""

Why = Literal["follow", "server", "first", "quickest", "only"]
"""Why a receiver is followed: the setting names it; it is the server; it reported first; it is clearly faster than the
previous one; no receiver has reported in time."""
Standing = Literal[0, 1, 2, 3]
"""0: has no token; 1: has a token; 2: has proved that it receives; 3: is followed."""


@dataclass
class Known:
    """State of one receiver.

    proved: it reported a message, and has reported in time since
    silent_s: time of the first missing report in a row; None while it reports in time
    heard_s: time of the last report;  took_s: times from put to report, newest last
    usual_s: usual time from put to report; None before there are enough reports
    """

    proved: bool = False
    silent_s: float | None = None
    heard_s: float = float("-inf")
    rtt_s: float = 0.0
    usual_s: float | None = None
    took_s: deque[float] = field(default_factory=lambda: deque(maxlen=MEASURED))


def clearly_slower(one_s: float | None, other_s: float | None) -> bool:
    """Whether the first time is clearly longer than the second; False while one of them is unknown."""
    return one_s is not None and other_s is not None and one_s > SLOWER_TIMES * other_s + SLOWER_S


class Followed:
    """The connected receivers, and the followed one. Not thread-safe: `Flight` holds a lock.

    Of the receivers with proof, the one named by the setting is followed, otherwise the server, otherwise the first. A
    clearly faster one replaces the first, so that a slow viewer, or one that pretends to be, does not delay others.
    """

    def __init__(
        self,
        named: str | None,
        clock: Callable[[], float] = time.monotonic,
        patience: float = 1.0,
        *,
        slow_server: bool = True,
    ) -> None:
        """patience: the wait for a silent receiver, as a multiple of its usual time
        slow_server: whether to follow the server even if it is clearly slower than others
        """
        self.named = named
        self._clock, self._patience, self._slow_server = clock, patience, slow_server
        self._known: OrderedDict[str, Known] = OrderedDict()
        self._first: str | None = None
        self._why_first: Why = "first"
        self._last: str | None = None
        self.turned_away = 0
        """Tokens of receivers for which there was no room."""

    def __contains__(self, name: object) -> bool:
        return name in self._known

    def __getitem__(self, name: str) -> Known:
        return self._known[name]

    def came(self, name: str) -> None:
        """A receiver has declared its token."""
        if name in self._known:
            return
        if len(self._known) >= MAX_RECEIVERS and not self._make_room(name):
            self.turned_away += 1
            return
        self._known[name] = Known()

    def went(self, name: str) -> None:
        """A receiver's token is gone."""
        self._known.pop(name, None)
        self._choose_first()

    def proved(self, name: str, took_s: float) -> None:
        """A known receiver has reported a message `took_s` after it was put."""
        known = self._known[name]
        known.proved, known.silent_s, known.heard_s = True, None, self._clock()
        known.took_s.append(took_s)
        if len(known.took_s) >= ENOUGH:
            known.usual_s = percentile(sorted(known.took_s), 0.5)
        self._choose_first()

    def silenced(self, name: str) -> None:
        """A known receiver did not report in time."""
        known = self._known[name]
        if known.silent_s is None:
            known.silent_s = self._clock()
        self._choose_first()

    def current(self) -> tuple[str | None, Why]:
        """The receiver that is followed, and why."""
        name, why = self._current()
        self._last = name
        return name, why

    def standing(self, name: str) -> Standing:
        """How far messages under this name can be trusted."""
        if name not in self._known:
            return 0
        if name == self.current()[0]:
            return 3
        return 2 if self._known[name].proved else 1

    def names(self) -> list[str]:
        """Receivers that have proved that they receive, at most 64."""
        return [name for name, known in self._known.items() if known.proved][:LISTED]

    def state(self) -> dict[str, Any]:
        """For the status."""
        unproved = sum(not known.proved for known in self._known.values())
        return {"receivers": self.names(), "unproved": unproved, "turned_away": self.turned_away}

    def _current(self) -> tuple[str | None, Why]:
        if self.named is not None and self._steers(self.named):
            return self.named, "follow"
        if self._first is not None:
            return self._first, self._why_first
        # No receiver reports: keep the one followed before, otherwise take any connected one.
        there = [name for name in self._known if self._waited_for(name)]
        if self._last in there and self._known[self._last].proved:
            return self._last, "only"
        fresh = [name for name in there if self._known[name].silent_s is None]
        for names in (fresh, there):
            for name in (self.named, SERVER_RECEIVER, *names[:1]):
                if name in names:
                    return name, "only"
        return None, "only"

    def _steers(self, name: str) -> bool:
        known = self._known.get(name)
        return known is not None and known.proved and known.silent_s is None

    def _waited_for(self, name: str) -> bool:
        known = self._known[name]
        limit_s = self._patience * (FORGET_S if known.proved else UNPROVED_S)
        return known.silent_s is None or self._clock() - known.silent_s < limit_s

    def _choose_first(self) -> None:
        """Choose the server, otherwise the first receiver, until it is silent or has left, or another one is clearly
        faster.
        """
        able = [name for name in self._known if self._steers(name)]
        measured = [(usual_s, name) for name in able if (usual_s := self._known[name].usual_s) is not None]
        quickest_s, quickest = min(measured, default=(None, None))
        server_s = self._known[SERVER_RECEIVER].usual_s if SERVER_RECEIVER in able else None
        if SERVER_RECEIVER in able and (self._slow_server or not clearly_slower(server_s, quickest_s)):
            self._first, self._why_first = SERVER_RECEIVER, "server"
        elif self._first not in able:
            self._first, self._why_first = (quickest or next(iter(able), None)), "first"
        elif self._first is not None and clearly_slower(self._known[self._first].usual_s, quickest_s):
            self._first, self._why_first = quickest, "quickest"

    def _make_room(self, name: str) -> bool:
        """Drop the receiver with the least evidence; returns whether there is room. Receivers that report are dropped
        only for a preferred one."""
        preferred = (self.named, SERVER_RECEIVER)
        kept = (*preferred, self.current()[0])
        others = [one for one in self._known if one not in kept]
        least = min(others, key=lambda one: (self._known[one].proved, self._known[one].heard_s), default=None)
        if least is None:
            return False
        reports = self._known[least].proved and self._clock() - self._known[least].heard_s < FORGET_S
        if reports and name not in preferred:
            return False
        del self._known[least]
        return True
