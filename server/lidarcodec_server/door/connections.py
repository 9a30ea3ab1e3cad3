"""Connections: limits of connections, so that a client with many does not keep others out.

Each host has a limit, and all hosts together have one. A connection beyond a limit replaces the connection that has
been idle longest, of the same host or of the host with the most connections. If none is idle, a few reserved places are
left for health checks and operators (`middleware.Reserved`).

>>> ledger = Connections(most=3, most_a_host=2)
>>> [ledger.admit(number, "10.0.0.1", lambda: print("the first gives way")) for number in range(3)]
the first gives way
['ordinary', 'ordinary', 'ordinary']
"""

from __future__ import annotations

import ipaddress
import logging
import time
from collections import Counter, OrderedDict
from collections.abc import Callable, Hashable, Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

from prometheus_client.metrics_core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from lidarcodec_server.limits import Meter, SparseLog

logger = logging.getLogger(__name__)

Place = Literal["ordinary", "reserved", "refused"]
LOG_S = 60.0
"""A host that is at its limit is logged once a minute, with a count."""
REASONS = ("gave way", "refused", "slow", "flood", "hasty")
"""Reasons for ending connections."""
BURST_S = 2.0
"""A burst may use the allowance of this many seconds."""
HOSTS_AT_RATE = 4
"""Rate limit of all hosts together, as a multiple of that of one host."""
REQUESTS_A_CONNECTION = 2.0
"""Rate limit of requests on open connections of a host, as a multiple of that of its new connections."""
NEW_TOKENS = 0.05
"""Rate limit of connections with an unknown token, as a multiple of the rate limit of one host."""
MAX_METERS = 8192
"""Number of rates that are remembered; the one used longest ago is dropped."""
V6_NETWORK = 64
"""Bits of an IPv6 network that providers give one customer. All addresses in it count as one host."""


@dataclass
class _Held:
    host: str
    place: Place
    end: Callable[[], object]


class Connections:
    """The connections of a server. Belongs to the event loop.

    most:        places of all hosts together;  most_a_host: places of one host
    reserved:    further places, for health checks and operators
    proxies:     addresses whose connections are counted with all, but have no limit of their own
    a_second:    connections that one host may make in a second; all hosts together may make four times as many
    ended:       connections that were ended, by reason
    """

    def __init__(
        self,
        most: int = 1000,
        most_a_host: int = 200,
        reserved: int = 16,
        proxies: Iterable[str] = (),
        a_second: float = 100.0,
    ) -> None:
        self.most, self.most_a_host, self.reserved = most, most_a_host, reserved
        self._a_second = a_second
        self._meters: OrderedDict[str, Meter] = OrderedDict()
        self._all_come = Meter(HOSTS_AT_RATE * a_second, round(BURST_S * HOSTS_AT_RATE * a_second), time.monotonic())
        self.ended: Counter[str] = Counter()
        self._proxies = frozenset(host_of(one) for one in proxies)
        self._held: dict[Hashable, _Held] = {}
        self._waiting: dict[str, dict[Hashable, None]] = {}
        """Idle connections of each host, longest idle first."""
        self._counts: dict[Place, Counter[str]] = {"ordinary": Counter(), "reserved": Counter()}
        self._log = SparseLog(logger, LOG_S)
        self._logs = {reason: SparseLog(logger, LOG_S) for reason in REASONS}

    def __len__(self) -> int:
        return len(self._held)

    def admit(self, key: Hashable, address: str, end: Callable[[], object]) -> Place:
        """The place of a new connection, which is idle at first. end: closes it at once

        A refused connection is not kept here; the caller closes it.
        """
        host = host_of(address)
        place = self._place(host)
        if place == "refused":
            self._note("refused", host)
            return place
        self._held[key] = _Held(host, place, end)
        self._counts[place][host] += 1
        self.waits(key)
        return place

    def waits(self, key: Hashable) -> None:
        """A connection becomes idle."""
        held = self._held.get(key)
        if held is not None:
            waiting = self._waiting.setdefault(held.host, {})
            waiting.pop(key, None)
            waiting[key] = None

    def works(self, key: Hashable) -> None:
        """A connection has a request, or is a WebSocket: it is not ended for others."""
        held = self._held.get(key)
        if held is not None:
            self._unwait(held.host, key)

    def gone(self, key: Hashable) -> None:
        """A connection has ended. A second call does nothing."""
        held = self._held.pop(key, None)
        if held is None:
            return
        self._unwait(held.host, key)
        counts = self._counts[held.place]
        counts[held.host] -= 1
        if not counts[held.host]:
            del counts[held.host]

    def renamed(self, key: Hashable, new: Hashable, end: Callable[[], object]) -> bool:
        """A connection has a new key and a new `end` after the TLS handshake. False if it was ended meanwhile."""
        held = self._held.pop(key, None)
        if held is None:
            return False
        self._unwait(held.host, key)
        held.end = end
        self._held[new] = held
        self.waits(new)
        return True

    def hasty(self, address: str) -> bool:
        """Whether the host of a new connection, or all hosts together, exceed the rate limit."""
        host, now_s = host_of(address), time.monotonic()
        if host in self._proxies:
            return False
        if self._all_come.wait_s(now_s) > 0 or self._meter(host).wait_s(now_s) > 0:
            return True
        self._meter(host).spend(1, now_s)
        self._all_come.spend(1, now_s)
        return False

    def hasty_client(self, name: str) -> bool:
        """Whether a client with a valid token connects too often itself. Asked when its host does.

        name: name of the token; empty for all clients with an unknown token. Some of these get in, so that new tokens
        become known
        """
        meter, now_s = self._meter(f"token {name}", 1.0 if name else NEW_TOKENS), time.monotonic()
        if meter.wait_s(now_s) > 0:
            return True
        meter.spend(1, now_s)
        return False

    def pause_s(self, address: str) -> float:
        """Count a request, and return the seconds that it must wait because its host sends too many."""
        host, now_s = host_of(address), time.monotonic()
        if host in self._proxies:
            return 0.0
        meter = self._meter(f"requests {host}", REQUESTS_A_CONNECTION)
        meter.spend(1, now_s)
        return meter.wait_s(now_s)

    def _meter(self, who: str, times: float = 1.0) -> Meter:
        meter = self._meters.get(who)
        if meter is None:
            meter = self._meters[who] = Meter(
                times * self._a_second, round(BURST_S * times * self._a_second), time.monotonic()
            )
            if len(self._meters) > MAX_METERS:
                self._meters.popitem(last=False)
        self._meters.move_to_end(who)
        return meter

    def end(self, reason: str, address: str, why: str) -> None:
        """Count and log a connection that its protocol ends because of its client. reason: one of REASONS"""
        self.ended[reason] += 1
        self._logs[reason].warning("a connection from %s was closed: %s", host_of(address), why)

    def _place(self, host: str) -> Place:
        ordinary, reserved = self._counts["ordinary"], self._counts["reserved"]
        if ordinary[host] >= self.most_a_host and host not in self._proxies:
            if self._give_way([host], "ordinary"):
                return "ordinary"
        elif ordinary.total() < self.most or self._give_way(_most_first(ordinary), "ordinary"):
            return "ordinary"
        if reserved.total() < self.reserved or self._give_way(_most_first(reserved), "reserved"):
            return "reserved"
        return "refused"

    def _give_way(self, hosts: Iterable[str], place: Place) -> bool:
        """End the longest idle connection with this place, of the first of these hosts that has one."""
        for host in hosts:
            for key in self._waiting.get(host, ()):
                held = self._held[key]
                if held.place == place:
                    self._note("gave way", host)
                    self.gone(key)
                    held.end()
                    return True
        return False

    def _unwait(self, host: str, key: Hashable) -> None:
        waiting = self._waiting.get(host)
        if waiting is not None:
            waiting.pop(key, None)
            if not waiting:
                del self._waiting[host]

    def _note(self, reason: str, host: str) -> None:
        self.ended[reason] += 1
        count = self._counts["ordinary"][host]
        self._log.warning("%s has %d of the %d open connections: a connection %s", host, count, len(self._held), reason)


class ConnectionMetrics(Collector):
    """How many connections there are, and how many were ended for others."""

    def __init__(self, connections: Connections) -> None:
        self._connections = connections

    def collect(self) -> Iterator[Metric]:
        """Now."""
        yield GaugeMetricFamily("lidarcodec_connections", "Open connections.", value=len(self._connections))
        ended = CounterMetricFamily(
            "lidarcodec_connections_ended", "Connections that were ended, by reason.", labels=["reason"]
        )
        for reason in REASONS:
            ended.add_metric([reason], self._connections.ended[reason])
        yield ended


@lru_cache(4096)
def host_of(address: str) -> str:
    """The host of an address: an IPv4 address, or the network of an IPv6 address.

    >>> host_of("::ffff:10.0.0.1"), host_of("2001:db8::7:1"), host_of("local")
    ('10.0.0.1', '2001:db8::/64', 'local')
    """
    try:
        found = ipaddress.ip_address(address.partition("%")[0])
    except ValueError:
        return address
    if isinstance(found, ipaddress.IPv4Address):
        return str(found)
    if found.ipv4_mapped is not None:
        return str(found.ipv4_mapped)
    return str(found) if found.is_loopback else str(ipaddress.ip_network((found, V6_NETWORK), strict=False))


def _most_first(counts: Counter[str]) -> list[str]:
    return [host for host, _ in counts.most_common()]
