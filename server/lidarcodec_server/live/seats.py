"""Seats: limits the live sockets of each client, so that places remain for others.

There are limits for all, for one client and for one host, and the last eighth of all is for operators. When no seat is
left, a new socket replaces one with a silent stream, or one of a client with clearly more sockets.

>>> seats = Seats(most=2, most_a_client=2)
>>> first, second = (seats.take(Seat("anna", "10.0.0.1", True)) for _ in range(2))
>>> second.end = lambda: print("the last of anna's gives way")
>>> bert = seats.take(Seat("bert", "10.0.0.2", True))
the last of anna's gives way
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final

from lidarcodec_server.door.connections import host_of

SILENT_S: Final = 60.0
"""A socket is replaced first if its stream has been silent for so long."""
FOR_OPERATORS: Final = 8
"""One of so many seats is for operators."""


class TooManyViewersError(Exception):
    """A limit of viewers is reached. own: the limit of one client or host, not that of all"""

    def __init__(self, message: str, *, own: bool = False) -> None:
        super().__init__(message)
        self.own = own


@dataclass(eq=False)
class Seat:
    """A live socket.

    client, host: name and host of the viewer;  operator: whether it may also change settings
    silent_s: time since the last message of its stream;  end: ends the socket
    """

    client: str
    host: str
    operator: bool
    silent_s: Callable[[], float] = lambda: 0.0
    end: Callable[[], object] = lambda: None


class Seats:
    """The live sockets of a server. Belongs to the event loop.

    most: most of all;  most_a_client, most_a_host: most of one client or host
    proxies: addresses of proxies, which stand for many hosts
    """

    def __init__(
        self, most: int = 64, most_a_client: int = 32, most_a_host: int = 48, proxies: Iterable[str] = ()
    ) -> None:
        self.most, self.most_a_client, self.most_a_host = most, most_a_client, most_a_host
        self._proxies = frozenset(host_of(one) for one in proxies)
        self._taken: list[Seat] = []

    def __len__(self) -> int:
        return len(self._taken)

    def of(self, client: str) -> int:
        """Number of live sockets of a client."""
        return sum(one.client == client for one in self._taken)

    def take(self, seat: Seat) -> Seat:
        """Take a seat; it may replace another one.

        Raises TooManyViewersError.
        """
        seat.host = host_of(seat.host)
        own = [one for one in self._taken if one.client == seat.client]
        if len(own) >= self.most_a_client and not self._free(_silent(own)):
            raise TooManyViewersError(f"'{seat.client}' has {len(own)} live sockets, which is the limit", own=True)
        here = [one for one in self._taken if one.host == seat.host]
        full = len(here) >= self.most_a_host and seat.host not in self._proxies
        if full and not self._free(_silent(here) or _of_the_greedy(here, len(own))):
            raise TooManyViewersError(f"{seat.host} has {len(here)} live sockets, which is the limit", own=True)
        viewers = [one for one in self._taken if not one.operator]
        room = self.most - self.most // FOR_OPERATORS
        if not seat.operator and len(viewers) >= room and not self._free(_gives_way(viewers, len(own))):
            raise TooManyViewersError(f"{len(viewers)} viewers are connected: the remaining places are for operators")
        if len(self._taken) >= self.most and not self._free(_gives_way(self._taken, len(own))):
            raise TooManyViewersError(f"{len(self._taken)} viewers are connected, which is the limit")
        self._taken.append(seat)
        return seat

    def leave(self, seat: Seat) -> None:
        """Leave a seat. A second call does nothing."""
        if seat in self._taken:
            self._taken.remove(seat)

    def _free(self, seat: Seat | None) -> bool:
        if seat is None:
            return False
        self.leave(seat)
        seat.end()
        return True


def _gives_way(seats: list[Seat], own: int) -> Seat | None:
    return _silent(seats) or _of_the_greedy(seats, own)


def _silent(seats: list[Seat]) -> Seat | None:
    """The seat whose stream has been silent longest, if that is long."""
    longest = max(seats, key=lambda one: one.silent_s(), default=None)
    return longest if longest is not None and longest.silent_s() >= SILENT_S else None


def _of_the_greedy(seats: list[Seat], own: int) -> Seat | None:
    """The newest seat of the client with the most seats, if it has clearly more than the new client."""
    client, most = Counter(one.client for one in seats).most_common(1)[0] if seats else ("", 0)
    return [one for one in seats if one.client == client][-1] if most > own + 1 else None
