"""Keeper: decides who may connect, go on to Zenoh, and stay. One thread; nothing in it grows without a limit."""

from __future__ import annotations

import selectors
import socket
from collections import Counter, OrderedDict
from collections.abc import Callable
from typing import Any, Final

from lidarcodec.gate.addresses import Address, Addresses, address_of
from lidarcodec.gate.limits import Bucket, Limits
from lidarcodec.gate.passage import READ, Passage, Stage
from lidarcodec.gate.records import Progress

ACCEPTED_AT_ONCE: Final = 64
LOOK_S: Final = 0.25
REFUSED: Final = (
    "barred",
    "too_many_new",
    "too_many_unfinished",
    "too_many_open",
    "no_hello",
    "not_tls",
    "no_turn",
    "late",
    "no_session",
    "unreachable",
)
"""Causes for which a connection is refused or ended before it has a session."""


class Keeper:
    """Takes connections from listeners, and passes them to ports of this machine."""

    def __init__(self, listeners: list[tuple[socket.socket, int]], limits: Limits, clock: Callable[[], float]) -> None:
        """listeners: sockets that listen, each with Zenoh's port behind it"""
        self._limits, self._clock = limits, clock
        self.selector = selectors.DefaultSelector()
        self._addresses = Addresses(limits)
        now_s = clock()
        burst, rate = limits.failing_burst, limits.failing_rate
        self._failing = {known: Bucket(burst, rate, now_s) for known in (False, True)}
        self._unfinished: OrderedDict[int, Passage] = OrderedDict()
        self._waiting: dict[int, Passage] = {}
        self._shaking: dict[int, Passage] = {}
        self._open: dict[int, Passage] = {}
        self._of_network: Counter[str] = Counter()
        """Connections without a session of each network, and those of them that are with Zenoh."""
        self._shaking_of_network: Counter[str] = Counter()
        self._look = False
        """Whether a connection that waits may perhaps go on."""
        self._looked_s = now_s
        self.refused: Counter[str] = Counter(dict.fromkeys(REFUSED, 0))
        self._totals: Counter[str] = Counter()
        self.last_barred: str | None = None
        for listener, port in listeners:
            listener.setblocking(False)
            self.selector.register(listener, READ, lambda _, one=listener, port=port: self._accept(one, port))

    def run_once(self, wait_s: float = LOOK_S) -> None:
        """Wait for something to do, at most so long, and do it."""
        for key, events in self.selector.select(wait_s):
            if self.selector.get_map().get(key.fd) is key:  # not closed by what came before it
                key.data(events)
        now_s = self._clock()
        if now_s - self._looked_s >= LOOK_S:
            self._looked_s = now_s
            self._end_late(now_s)
            self._look = True
        if self._look and self._waiting:
            self._admit(now_s)
        self._look = False

    def state(self) -> dict[str, Any]:
        """Counts for a status; docs/live.md lists them."""
        return {
            "open": len(self._open),
            "unfinished": len(self._unfinished),
            "waiting": len(self._waiting),
            "barred": self._addresses.barred(self._clock()),
            "sessions": self._totals["sessions"],
            "failed": self._totals["failed"],
            "refused": dict(self.refused),
            "bytes_in": self._totals["bytes_in"] + sum(one.to_zenoh for one in self._open.values()),
            "bytes_out": self._totals["bytes_out"] + sum(one.to_client for one in self._open.values()),
            "last_barred": self.last_barred,
        }

    def close(self) -> None:
        """End all connections."""
        for one in [*self._unfinished.values(), *self._open.values()]:
            one.close()
        self.selector.close()

    def _accept(self, listener: socket.socket, port: int) -> None:
        for _ in range(ACCEPTED_AT_ONCE):
            try:
                client, where = listener.accept()
            except OSError:  # none is left, it has gone already, or there are no handles
                return
            now_s = self._clock()
            address = self._addresses.seen(address_of(where[0]), now_s)
            cause = self._refusal(address, now_s)
            if cause is not None:
                self.refused[cause] += 1
                _drop(client)
                continue
            client.setblocking(False)
            passage = Passage(self.selector, client, address, port, now_s, self._changed)
            self._unfinished[id(passage)] = passage
            address.unfinished += 1
            self._of_network[address.network] += 1

    def _refusal(self, address: Address, now_s: float) -> str | None:
        """Why an address may not have one more connection; makes room for it if it may."""
        limits = self._limits
        if address.barred(now_s) and not (address.known(now_s) and address.trickle.take(now_s)):
            return "barred"
        if not address.new.take(now_s):
            return "too_many_new"
        if address.open >= limits.open_address or len(self._open) >= limits.open:
            return "too_many_open"
        if address.unfinished >= limits.unfinished_address and not self._push_out(address):
            return "too_many_unfinished"
        if len(self._unfinished) >= limits.unfinished and not self._make_room(address, now_s):
            return "too_many_unfinished"
        return None

    def _make_room(self, address: Address, now_s: float) -> bool:
        """End a connection that is not with Zenoh for one more of an address; whether there was one.

        Strangers give way first, then the network that has most, and in it the address; a connection that has sent its
        ClientHello only to who is known or has fewer.
        """

        def rank(one: Passage) -> tuple[bool, int, int, bool]:
            other = one.address
            silent = one.stage is Stage.HELLO
            return not other.known(now_s), self._of_network[other.network], other.unfinished, silent

        held = [one for one in self._unfinished.values() if one.stage in (Stage.HELLO, Stage.WAITING)]
        if not held:
            return False
        first = max(held, key=rank)
        stranger, of_network, of_address, silent = rank(first)
        known = address.known(now_s)
        more = of_network > self._of_network[address.network] + 1 or of_address > address.unfinished + 1
        if (not stranger and not known) or not (silent or more or (known and stranger)):
            return False
        self._end(first, "too_many_unfinished")
        return True

    def _push_out(self, address: Address) -> bool:
        """End the oldest connection of an address that has sent no whole ClientHello; clients of Zenoh send it at once.

        Returns whether there was one.
        """
        silent = (one for one in self._unfinished.values() if one.stage is Stage.HELLO)
        oldest = next((one for one in silent if one.address is address), None)
        if oldest is None:
            return False
        self._end(oldest, "too_many_unfinished")
        return True

    def _admit(self, now_s: float) -> None:
        """Let connections go on to Zenoh: those of known addresses, and of all others, each while so few handshakes are
        under way or failed that Zenoh gets over it. The network that had a turn longest ago goes first, in it the
        address, and of those the newest: oldest first, all would wait until they are given up where too many come."""
        full: set[tuple[bool, int, int]] = set()
        for one in sorted(self._waiting.values(), key=lambda one: (self._addresses.turns(one.address), -one.hello_s)):
            address = one.address
            known = address.known(now_s)
            if address.at_zenoh >= self._limits.at_once or self._failing[known].held(now_s) < 1.0:
                continue
            has = known, self._shaking_of_network[address.network], address.shaking
            if has in full:
                continue
            if not self._has_room(*has, now_s):
                full.add(has)
                continue
            self._failing[known].take(now_s)
            self._addresses.has_turn(address)
            address.at_zenoh += 1
            address.shaking += 1
            self._shaking_of_network[address.network] += 1
            del self._waiting[id(one)]
            self._shaking[id(one)] = one
            one.counts_as_failing, one.known = True, known
            try:
                one.connect(now_s)
            except OSError:
                self._end(one, "unreachable")

    def _has_room(self, known: bool, of_network: int, of_address: int, now_s: float) -> bool:
        """Whether one more connection may be with Zenoh, of an address that is known or not and has so many there, as
        its network has. Makes room at the cost of strangers, then of the network, and the address, that has more."""
        if len(self._shaking) < self._limits.pending:
            return True

        def rank(one: Passage) -> tuple[bool, int, int]:
            other = one.address
            return not other.known(now_s), self._shaking_of_network[other.network], other.shaking

        first = max(self._shaking.values(), key=rank)
        stranger, its_network, its_address = rank(first)
        more = its_network > of_network + 1 or its_address > of_address + 1
        if (not stranger and not known) or not (more or (known and stranger)):
            return False
        self._end(first, "no_session")
        return True

    def _changed(self, passage: Passage, cause: str | None) -> None:
        """A connection made progress, or must be closed."""
        now_s = self._clock()
        if cause is not None:
            return self._end(passage, cause)
        if passage.counts_as_failing and passage.left:
            return self._end(passage, "left")
        if passage.ending and passage.ended_s is None:
            passage.ended_s, passage.sent_away = now_s, not passage.left
        if passage.stage is Stage.WAITING:
            passage.hello_s = now_s
            self._waiting[id(passage)] = passage
            self._look = True
        progress = passage.progress
        if progress is None or passage.stage is not Stage.SHAKING:
            return None
        if progress.turns and passage.counts_as_failing:
            self._trust(passage, now_s)
        if progress.turns >= Progress.SESSION:
            self._opened(passage, now_s)
        return None

    def _trust(self, passage: Passage, now_s: float) -> None:
        """TLS stands: what it took of Zenoh's patience is given back."""
        if self._limits.mutual:
            passage.address.known_until_s = now_s + self._limits.known_s
        passage.counts_as_failing = False
        self._failing[passage.known].give_back()
        passage.address.at_zenoh -= 1
        self._look = True

    def _opened(self, passage: Passage, now_s: float) -> None:
        """It seems to have a session; of one who showed a certificate that is sure."""
        passage.progress, passage.stage = None, Stage.OPEN
        passage.opened_s = now_s
        address = passage.address
        self._ended_unfinished(passage)
        self._open[id(passage)] = passage
        address.open += 1
        if self._limits.mutual:
            self._stands(passage, now_s)

    def _stands(self, passage: Passage, now_s: float) -> None:
        """A session is sure."""
        passage.opened_s = None
        passage.address.standing += 1
        passage.address.known_until_s = now_s + self._limits.known_s
        self._totals["sessions"] += 1

    def _ended_unfinished(self, passage: Passage) -> None:
        """It is no longer one of those without a session."""
        address = passage.address
        del self._unfinished[id(passage)]
        self._waiting.pop(id(passage), None)
        address.unfinished -= 1
        _count_down(self._of_network, address.network)
        if self._shaking.pop(id(passage), None) is not None:
            address.shaking -= 1
            _count_down(self._shaking_of_network, address.network)

    def _end_late(self, now_s: float) -> None:
        limits = self._limits
        for one in list(self._unfinished.values()):
            if one.ended_s is not None and now_s - one.ended_s > limits.close_s:
                self._end(one, "left")
            elif one.stage is Stage.HELLO and now_s - one.begun_s > limits.hello_s:
                self._end(one, "no_hello")
            elif one.stage is Stage.WAITING and now_s - one.hello_s > limits.wait_s:
                self._end(one, "no_turn")
            elif one.counts_as_failing and now_s - one.hello_s > limits.handshake_s:
                self._end(one, "late")
            elif one.stage is Stage.SHAKING and now_s - one.hello_s > limits.session_s:
                self._end(one, "no_session")
        for one in list(self._open.values()):
            if one.ended_s is not None and now_s - one.ended_s > limits.close_s:
                self._end(one, "ended")
            elif one.stuck_for(now_s) > limits.stuck_s:
                self._end(one, "stuck")
            elif one.opened_s is not None and now_s - one.opened_s > limits.stands_s:
                self._stands(one, now_s)

    def _end(self, passage: Passage, cause: str) -> None:
        """Close a connection, count why, and count it against its address where its handshake failed."""
        stage, address, now_s = passage.stage, passage.address, self._clock()
        if stage is Stage.CLOSED:
            return
        refused = self._is_refused(passage)
        passage.close(reset=stage is not Stage.OPEN)
        if refused:
            self._failed(address, now_s)
        if stage is Stage.OPEN:
            del self._open[id(passage)]
            address.open -= 1
            address.standing -= passage.opened_s is None
            self._totals["bytes_in"] += passage.to_zenoh
            self._totals["bytes_out"] += passage.to_client
            return
        self._ended_unfinished(passage)
        self._look = True
        if cause in REFUSED:
            self.refused[cause] += 1
        if passage.counts_as_failing:
            address.at_zenoh -= 1
        if passage.counts_as_failing and cause != "unreachable":
            self._failed(address, now_s)

    def _is_refused(self, passage: Passage) -> bool:
        """Whether Zenoh has ended a connection after TLS stood and before its session was sure. Without certificates,
        a wrong password causes that."""
        unsure = passage.stage is Stage.SHAKING or passage.opened_s is not None
        return not self._limits.mutual and unsure and passage.sent_away and not passage.counts_as_failing

    def _failed(self, address: Address, now_s: float) -> None:
        """Count a handshake or password of an address that was wrong."""
        self._totals["failed"] += 1
        if self._addresses.failed(address, now_s):
            self.last_barred = address.name


def _count_down(counts: Counter[str], name: str) -> None:
    """One less; a name that has none is forgotten."""
    counts[name] -= 1
    if not counts[name]:
        del counts[name]


def _drop(client: socket.socket) -> None:
    """Close without a trace: nothing waits for the other end."""
    client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
    client.close()
