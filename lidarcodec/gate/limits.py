"""Limits of the gate, and the buckets that hold rates to them."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import Self


@dataclass(frozen=True)
class Limits:
    """What one address, and all together, may hold and try. An address is an IPv4 address or the /64 of an IPv6 one.

    hello_s:        time for a whole ClientHello
    wait_s:         time to wait for a turn; a client that was refused tries again at once, and the newest goes first
    handshake_s:    time for the handshake
    session_s:      time until Zenoh has opened a session; its own limit is 10 s
    close_s:        time to send the rest when one end has closed
    stuck_s:        time without a byte that one end takes while it is owed some; Zenoh gives a link up after 10 s
    unfinished:     connections without a session, of all addresses; unfinished_address: of one
    open:           connections with a session, of all addresses; Zenoh's own limit is 1,000; open_address: of one
    new_rate:       new connections a second of one address; new_burst: how many at once
    bar_after:      handshakes of one address that fail at Zenoh, wrong passwords too, until it is barred
    forgiven_s:     time after which one of these is forgotten
    bar_s:          how long an address is barred
    barred_rate:    connections a second that a barred address may try if it had a session before: one address may be
                    that of a stranger and of a viewer with a certificate
    failing_rate:   handshakes a second that may fail at Zenoh, which bears ten: once for addresses that are known
                    already, and once for all others; failing_burst: how many at once
    pending:        connections without a session that are with Zenoh, of all addresses; its own limit is 100
    at_once:        handshakes of one address that are with Zenoh at a time
    mutual:         whether Zenoh asks clients for a certificate; then an address that passes the handshake is known
    stands_s:       time from which on a session is sure, where `mutual` is not: Zenoh has ended by then who has a wrong
                    password, or none
    known_s:        how long an address stays known after its last session was sure, or its last handshake if `mutual`
    """

    hello_s: float = 5.0
    wait_s: float = 1.0
    handshake_s: float = 8.0
    session_s: float = 15.0
    close_s: float = 5.0
    stuck_s: float = 15.0
    unfinished: int = 1024
    unfinished_address: int = 32
    open: int = 1000
    open_address: int = 250
    new_rate: float = 50.0
    new_burst: float = 100.0
    bar_after: float = 6.0
    forgiven_s: float = 20.0
    bar_s: float = 30.0
    barred_rate: float = 1.0
    failing_rate: float = 3.0
    failing_burst: float = 16.0
    pending: int = 80
    at_once: int = 8
    mutual: bool = False
    stands_s: float = 15.0
    known_s: float = 86400.0

    def packed(self) -> str:
        """As JSON, for the command line of the gate's process."""
        return json.dumps(asdict(self))

    @classmethod
    def unpacked(cls, text: str) -> Self:
        """From that JSON."""
        return cls(**json.loads(text))


class Bucket:
    """Holds up to `most` tokens, and gets `rate` of them a second.

    >>> bucket = Bucket(2.0, 1.0, now_s=0.0)
    >>> bucket.take(0.0), bucket.take(0.0), bucket.take(0.5), bucket.take(1.0)
    (True, True, False, True)
    """

    __slots__ = ("_at_s", "_held", "_most", "_rate")

    def __init__(self, most: float, rate: float, now_s: float) -> None:
        self._most, self._rate, self._held, self._at_s = most, rate, most, now_s

    def held(self, now_s: float) -> float:
        """Tokens that are there now."""
        self._held = min(self._most, self._held + (now_s - self._at_s) * self._rate)
        self._at_s = now_s
        return self._held

    def take(self, now_s: float) -> bool:
        """Take one; whether there was one."""
        if self.held(now_s) < 1.0:
            return False
        self._held -= 1.0
        return True

    def give_back(self) -> None:
        """Return one that was taken."""
        self._held = min(self._most, self._held + 1.0)

    def full(self, now_s: float) -> bool:
        """Whether no token is missing."""
        return self.held(now_s) >= self._most
