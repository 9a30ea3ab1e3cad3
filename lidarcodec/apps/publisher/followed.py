"""Followed: which receiver's arrival reports steer a publisher, and why.

A receiver shows that it is there with a liveliness token. It steers only after it has proved that it receives: with a
report that names a message sent lately and repeats its checksum, which nobody knows who has not received the message.
Whoever only claims to receive is waited for briefly, and only while nobody else has proved anything.
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
"""Receivers that are known. Behind them those with the least evidence give way."""
LISTED = 64
"""Receivers that the status names."""
FORGET_S, UNPROVED_S = 10.0, 3.0
"""A receiver that leaves messages without a report for so long is not waited for until it reports; and one that never
reported."""
MEASURED, ENOUGH = 8, 4
"""Reports from which it is told how quick a receiver is, and how many are needed."""
SLOWER_TIMES, SLOWER_S = 1.5, 0.03
"""So much slower than another receiver is clearly slower: that many times, and by so long. A frame that fits its path
is under way for 65 ms at 10 Hz; lateness beyond that, which others do not share, must not make it smaller for them."""

Why = Literal["follow", "server", "first", "quickest", "only"]
"""Why a receiver is followed: the setting names it; it is the server; it reported first; it is clearly quicker than
the one before; nobody has reported in time."""
Standing = Literal[0, 1, 2, 3]
"""0: shows no token; 1: shows one; 2: has proved that it receives; 3: is followed."""


@dataclass
class Known:
    """What is known of one receiver.

    proved: it reported a message, and was not given up since
    silent_s: when it was first given up in a row; None while it reports in time
    heard_s: when it reported last;  took_s: times from put to report, newest last
    usual_s: how long its reports usually take; None before there are enough of them
    """

    proved: bool = False
    silent_s: float | None = None
    heard_s: float = float("-inf")
    rtt_s: float = 0.0
    usual_s: float | None = None
    took_s: deque[float] = field(default_factory=lambda: deque(maxlen=MEASURED))


def clearly_slower(one_s: float | None, other_s: float | None) -> bool:
    """Whether the first time is so much longer than the second that it matters; not while one of them is unknown."""
    return one_s is not None and other_s is not None and one_s > SLOWER_TIMES * other_s + SLOWER_S


class Followed:
    """The receivers that are there, and the one that is followed. Not thread-safe: `Flight` holds a lock.

    Of those that have proved that they receive it is the one that is named, else the server, else the first; a clearly
    quicker one takes the place of the first, so that a viewer who is slow, or says so, holds up nobody else.
    """

    def __init__(
        self,
        named: str | None,
        clock: Callable[[], float] = time.monotonic,
        patience: float = 1.0,
        *,
        slow_server: bool = True,
    ) -> None:
        """patience: how many times longer than usual a silent receiver is waited for
        slow_server: the server is followed, too, when it is clearly slower than others: its path may be slow
        """
        self.named = named
        self._clock, self._patience, self._slow_server = clock, patience, slow_server
        self._known: OrderedDict[str, Known] = OrderedDict()
        self._first: str | None = None
        self._why_first: Why = "first"
        self._last: str | None = None
        self.turned_away = 0
        """Tokens for which there was no room."""

    def __contains__(self, name: object) -> bool:
        return name in self._known

    def __getitem__(self, name: str) -> Known:
        return self._known[name]

    def came(self, name: str) -> None:
        """A receiver shows a token."""
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
        """A receiver that is known has reported a message that was put so long ago."""
        known = self._known[name]
        known.proved, known.silent_s, known.heard_s = True, None, self._clock()
        known.took_s.append(took_s)
        if len(known.took_s) >= ENOUGH:
            known.usual_s = percentile(sorted(known.took_s), 0.5)
        self._choose_first()

    def silenced(self, name: str) -> None:
        """A receiver that is known did not report in time."""
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
        """How much is to be given on what somebody says under a name."""
        if name not in self._known:
            return 0
        if name == self.current()[0]:
            return 3
        return 2 if self._known[name].proved else 1

    def names(self) -> list[str]:
        """Those that have proved that they receive, at most 64."""
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
        # Nobody reports: the one that was followed may again, else somebody who is there may.
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
        """The server; else, of equals, the first, until another one is clearly quicker, or it is silent, or gone."""
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
        """Whether the one with the least evidence gave way. Those that report give way to who is preferred only."""
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
