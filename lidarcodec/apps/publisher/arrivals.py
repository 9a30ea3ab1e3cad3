"""Arrival reports of a stream, and its receivers that come and go, handed on to a `Flight`."""

from __future__ import annotations

from collections.abc import Callable

from lidarcodec.apps.publisher.flight import Flight
from lidarcodec.apps.reports import read_arrival
from lidarcodec.settings import is_name
from lidarcodec.transport import Transport
from lidarcodec.transport.base import Closeable
from lidarcodec.transport.keys import StreamKeys


def listen_for_arrivals(
    transport: Transport, keys: StreamKeys, flight: Flight, came: Callable[[], object]
) -> list[Closeable]:
    """Declare both subscriptions. came: called when a receiver has come, which needs a key frame

    What is called runs in threads of the transport, so it must be fast. Raises TransportError.
    """

    def changed(key: str, alive: bool) -> None:
        name = key.rpartition("/")[2]
        if alive and is_name(name):
            flight.came(name)
            came()
        else:
            flight.went(name)

    def arrived(key: str, data: bytes) -> None:
        name, arrival = key.rpartition("/")[2], read_arrival(data)
        if arrival is not None and is_name(name):
            flight.reported(name, arrival.frame_index, arrival.checksum, arrival.held_ns / 1e9, arrival.has)

    return [transport.watch(keys.arrived(), changed), transport.listen(keys.arrived(), arrived)]
