"""Swarm: many vehicles from one source, for load tests of a router, a server or a network.

Every vehicle is a complete publisher that assembles and encodes frames. All vehicles share the network session and the
source, which is read once and played from memory. They start at different times, like real vehicles.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any

from lidarcodec.apps.publisher.publisher import Publisher
from lidarcodec.assembly.rotation import turns_of
from lidarcodec.errors import SourceError
from lidarcodec.packet import Packet, part_of
from lidarcodec.sensor_model import SensorModel
from lidarcodec.settings import StreamSettings, valid_name
from lidarcodec.sources import open_source
from lidarcodec.sources.base import PacketSource
from lidarcodec.sources.pacing import PacedSource
from lidarcodec.transport import Endpoints, Transport, open_transport
from lidarcodec.units import FRAME_PACKETS, PACKET_INTERVAL_US

NOMINAL_HZ = 1e6 / (FRAME_PACKETS * PACKET_INTERVAL_US)


def vehicle_names(prefix: str, first: int, count: int) -> list[str]:
    """Names of the vehicles of a swarm.

    Raises SettingsError if a name cannot begin with the prefix.

    >>> vehicle_names("car", 8, 3)
    ['car-008', 'car-009', 'car-010']
    """
    return [valid_name(f"{prefix}-{number:03d}", "vehicle") for number in range(first, first + count)]


def loaded(spec: str, frames: int) -> tuple[SensorModel, list[Packet]]:
    """Packets of the first turns of a source, 0.4 MB for each.

    Raises SourceError if there are none, and the errors of opening and reading.
    """
    with open_source(spec) as source:
        if source.sensor.is_hdl64e:
            packets = list(turns_of(source.packets(), frames))
        else:
            packets = list(part_of(source.packets(), 0, frames * FRAME_PACKETS))
        if not packets:
            raise SourceError(f"{spec} has no packets")
        return source.sensor, packets


class MemorySource(PacketSource):
    """A source of packets in memory."""

    def __init__(self, sensor: SensorModel, packets: list[Packet]) -> None:
        super().__init__(sensor)
        self._packets = packets

    def packets(self) -> Iterator[Packet]:
        """All packets, in order."""
        return iter(self._packets)


class Swarm:
    """Vehicles that all publish the same source. Each encodes it itself. A context manager."""

    def __init__(
        self,
        names: list[str],
        sensor: SensorModel,
        packets: list[Packet],
        settings: StreamSettings,
        *,
        rate: float = 10.0,
        endpoints: Endpoints | None = None,
    ) -> None:
        """Raises SettingsError or UnknownNameError."""
        self._endpoints, self._every_s = endpoints, 1.0 / rate
        self._transport: Transport | None = None
        self._stop = threading.Event()
        self.failure: BaseException | None = None

        def source() -> PacedSource:
            return PacedSource(MemorySource(sensor, packets), speed=rate / NOMINAL_HZ, loop=True, restamp=True)

        self._publishers = [Publisher(source(), settings, vehicle=name, transport=self._opened) for name in names]

    def start(self) -> None:
        """Open the network and begin. Raises TransportError if it cannot be opened, or `stop` was called."""
        self._transport = open_transport(self._endpoints, stop=self._stop)
        for publisher in self._publishers:
            if self._stop.wait(self._every_s / len(self._publishers)):
                return
            publisher.start()

    def interrupt(self) -> None:
        """Make `start` return soon. For signal handlers."""
        self._stop.set()

    def stop(self) -> None:
        """End everything. A second call does nothing."""
        self._stop.set()
        for publisher in self._publishers:
            publisher.stop()
        if self._transport is not None:
            self._transport.close()

    def statuses(self) -> list[dict[str, Any]]:
        """The status of every vehicle."""
        return [publisher.status() for publisher in self._publishers]

    def __enter__(self) -> Swarm:
        self.start()
        return self

    def __exit__(self, *exc: object) -> None:
        self.stop()

    def _opened(self, _stop: threading.Event) -> Transport:
        if self._transport is None:
            self._transport = open_transport(self._endpoints, stop=self._stop)
        return self._transport
