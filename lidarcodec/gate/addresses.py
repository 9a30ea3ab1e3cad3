"""What is known of each address: how much it holds, what failed, and whether it had a session before."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from ipaddress import IPv6Address, ip_address
from typing import Final

from lidarcodec.gate.limits import Bucket, Limits

MOST: Final = 4096
"""Addresses remembered; beyond it the one that was seen longest ago, and holds no connection, is forgotten."""


def address_of(host: str) -> str:
    """What counts as one address: an IPv4 address, or the /64 of an IPv6 one, which one subscriber has.

    >>> address_of("192.0.2.1"), address_of("::ffff:192.0.2.1"), address_of("2001:db8::1%eth0")
    ('192.0.2.1', '192.0.2.1', '2001:db8::/64')
    """
    address = ip_address(host.partition("%")[0])
    if not isinstance(address, IPv6Address):
        return host
    if address.ipv4_mapped is not None:
        return str(address.ipv4_mapped)
    return f"{IPv6Address(int(address) >> 64 << 64)}/64"


def network_of(address: str) -> str:
    """The network that one party may own whole: the /24 of an IPv4 address, the /48 of an IPv6 one.

    >>> network_of("192.0.2.1"), network_of("2001:db8:1:2::/64")
    ('192.0.2', '2001:db8:1::/48')
    """
    if "/" not in address:
        return address.rpartition(".")[0]
    return f"{IPv6Address(int(IPv6Address(address.partition('/')[0])) >> 80 << 80)}/48"


@dataclass(slots=True)
class Address:
    """One address. unfinished: its connections without a session; shaking: those of them that are with Zenoh;
    at_zenoh: those of them whose handshake goes on; turn: number of the last one that went on to Zenoh; open: those
    with a session, of which it is sure that they have one: standing"""

    name: str
    network: str
    new: Bucket
    faults: Bucket
    trickle: Bucket
    unfinished: int = 0
    shaking: int = 0
    at_zenoh: int = 0
    open: int = 0
    standing: int = 0
    turn: int = 0
    barred_until_s: float = 0.0
    known_until_s: float = 0.0

    def barred(self, now_s: float) -> bool:
        """Whether it is barred now."""
        return now_s < self.barred_until_s

    def known(self, now_s: float) -> bool:
        """Whether it had a session not long ago."""
        return self.standing > 0 or now_s < self.known_until_s


class Addresses:
    """All addresses, the one that was seen last at the end. Their number is bounded."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._found: OrderedDict[str, Address] = OrderedDict()
        self._networks: OrderedDict[str, int] = OrderedDict()
        self._turn = 0

    def seen(self, name: str, now_s: float) -> Address:
        """The address, new or known."""
        found = self._found.get(name)
        if found is None:
            limits = self._limits
            new = Bucket(limits.new_burst, limits.new_rate, now_s)
            faults = Bucket(limits.bar_after, 1.0 / limits.forgiven_s, now_s)
            trickle = Bucket(1.0, limits.barred_rate, now_s)
            found = self._found[name] = Address(name, network_of(name), new, faults, trickle)
            if len(self._found) > MOST:
                self._forget_one(now_s)
        self._found.move_to_end(name)
        return found

    def turns(self, address: Address) -> tuple[int, int]:
        """For sorting: when the network of an address had its last turn, and when the address had. 0: never."""
        return self._networks.get(address.network, 0), address.turn

    def has_turn(self, address: Address) -> None:
        """It is the turn of this address now."""
        self._turn += 1
        address.turn = self._turn
        self._networks[address.network] = self._turn
        self._networks.move_to_end(address.network)
        if len(self._networks) > MOST:
            self._networks.popitem(last=False)

    def failed(self, address: Address, now_s: float) -> bool:
        """A handshake failed; whether the address is barred for it."""
        if not address.faults.take(now_s):
            return False
        if address.faults.held(now_s) >= 1.0 or address.barred(now_s):
            return False
        address.barred_until_s = now_s + self._limits.bar_s
        return True

    def barred(self, now_s: float) -> int:
        """Number of addresses that are barred now."""
        return sum(one.barred(now_s) for one in self._found.values())

    def _forget_one(self, now_s: float) -> None:
        """Of those without a connection: first strangers, then those that had a session."""
        idle = [one for one in list(self._found.values())[:-1] if not one.unfinished and not one.open]
        strangers = (one for one in idle if not one.known(now_s) and not one.barred(now_s))
        gone = next(strangers, idle[0] if idle else None)
        if gone is not None:
            del self._found[gone.name]
