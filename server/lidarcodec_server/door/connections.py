"""Connections: which ones a server keeps, so that a client with many does not keep others out.

A host has so many, and all together have so many. One more takes the place of a connection that waits for nothing, the
one that has waited longest, of the same host or of the host that has most. Where none waits, a few more places are
reserved: they serve health checks and operators only (`middleware.Reserved`).

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
"""Why connections are ended."""
BURST_S = 2.0
"""What may be done in so many seconds may also be done at once."""
HOSTS_AT_RATE = 4
"""All hosts together may connect as often as so many of them."""
REQUESTS_A_CONNECTION = 2.0
"""Further requests of a host on connections that are open, for each new connection that it may make."""
NEW_TOKENS = 0.05
"""Connections with a token that is not known, for each that a host may make."""
MAX_METERS = 8192
"""Rates that are remembered; the one that was looked at longest ago gives way."""
V6_NETWORK = 64
"""Bits of an IPv6 address that one customer of a provider has: a host is all addresses that share them."""


@dataclass
class _Held:
    host: str
    place: Place
    end: Callable[[], object]


class Connections:
    """The connections of a server. Belongs to the event loop.

    most:        places of all hosts together;  most_a_host: of one
    reserved:    further places, for health checks and operators
    proxies:     addresses whose connections are counted with all, but have no limit of their own
    a_second:    connections that one host may make in a second, and four times as many all together
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
        """Of each host those that wait for nothing, the longest first."""
        self._counts: dict[Place, Counter[str]] = {"ordinary": Counter(), "reserved": Counter()}
        self._log = SparseLog(logger, LOG_S)
        self._logs = {reason: SparseLog(logger, LOG_S) for reason in REASONS}

    def __len__(self) -> int:
        return len(self._held)

    def admit(self, key: Hashable, address: str, end: Callable[[], object]) -> Place:
        """The place that a new connection has; it waits for a request. end: closes it at once

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
        """A connection has nothing to do: it is the last of its host to give way."""
        held = self._held.get(key)
        if held is not None:
            waiting = self._waiting.setdefault(held.host, {})
            waiting.pop(key, None)
            waiting[key] = None

    def works(self, key: Hashable) -> None:
        """A connection has a request, or is a WebSocket: it does not give way."""
        held = self._held.get(key)
        if held is not None:
            self._unwait(held.host, key)

    def gone(self, key: Hashable) -> None:
        """A connection has ended; harmless when called twice."""
        held = self._held.pop(key, None)
        if held is None:
            return
        self._unwait(held.host, key)
        counts = self._counts[held.place]
        counts[held.host] -= 1
        if not counts[held.host]:
            del counts[held.host]

    def renamed(self, key: Hashable, new: Hashable, end: Callable[[], object]) -> bool:
        """A connection is encrypted now, and closed by `end`. False if it has ended, or given way, meanwhile."""
        held = self._held.pop(key, None)
        if held is None:
            return False
        self._unwait(held.host, key)
        held.end = end
        self._held[new] = held
        self.waits(new)
        return True

    def hasty(self, address: str) -> bool:
        """Whether the host of a new connection has connected too often just now, or all hosts together have."""
        host, now_s = host_of(address), time.monotonic()
        if host in self._proxies:
            return False
        if self._all_come.wait_s(now_s) > 0 or self._meter(host).wait_s(now_s) > 0:
            return True
        self._meter(host).spend(1, now_s)
        self._all_come.spend(1, now_s)
        return False

    def hasty_client(self, name: str) -> bool:
        """Whether a client whose token works, on a host that connects too often, has done so itself.

        name: empty for all together whose token is not known yet; some get in, so that new tokens become known
        """
        meter, now_s = self._meter(f"token {name}", 1.0 if name else NEW_TOKENS), time.monotonic()
        if meter.wait_s(now_s) > 0:
            return True
        meter.spend(1, now_s)
        return False

    def pause_s(self, address: str) -> float:
        """How long the next request on a connection has to wait, because its host asks too often; counts it."""
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
        """Count a connection that its own protocol ends for what its client does, and say so; reason: one of REASONS"""
        self.ended[reason] += 1
        self._logs[reason].warning("a connection of %s was closed: %s", host_of(address), why)

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
        """End the connection of such a place that has waited longest, of the first of these hosts that has any."""
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
        self._log.warning("%s holds %d connections of %d: a connection %s", host, count, len(self._held), reason)


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
    """What counts as one host: an IPv4 address, or the network of an IPv6 address.

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
