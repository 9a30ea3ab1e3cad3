"""The interface of a source: packets, the sensor that sent them, and counts of irregularities."""

from __future__ import annotations

from abc import abstractmethod
from collections import Counter
from collections.abc import Iterator
from typing import TYPE_CHECKING, Final, Protocol, Self

from lidarcodec.packet import Packet
from lidarcodec.sensor_model import SensorModel

if TYPE_CHECKING:
    from lidarcodec.mounting import Mounting
    from lidarcodec.sources.posed import CarriedPoses
    from lidarcodec.sources.poses import Poses


REGRIDDED: Final = "KITTI odometry, re-gridded"
"""Marks the name of a sensor whose scans were re-gridded. Messages and recordings carry the name."""


class Source(Protocol):
    """A source of one sensor's packets; a context manager.

    sensor: the model and calibration that were found; sensor.origin is their origin
    live:   True when packets come at the sensor's own pace (UDP), False when they can be read as fast as wanted
    counts: packets skipped or irregular, by cause (`truncated`, `wrong length`, `kernel drops`, ...), and `position
            packets`, the number given
    """

    sensor: SensorModel
    live: bool
    counts: Counter[str]

    def packets(self) -> Iterator[Packet]:
        """Packets in order of receipt: data packets, and position packets among them.

        Raises SourceError when the source cannot be read, PacketError for a sensor that is not supported.
        """

    def finish(self) -> None:
        """End a live source: `packets` then ends after the packets received so far if possible, otherwise at once."""

    def close(self) -> None:
        """Close files and sockets; a waiting `packets` ends. A second call does nothing."""

    def __enter__(self) -> Source: ...

    def __exit__(self, *exc: object) -> None: ...


class PacketSource(Source):
    """Base class of all sources.

    label:    description in one line
    poses:    poses of the sensor, if known
    carried:  of a recording of messages: the poses that they carry, for frames that are cut from its packets
    mount:    where the sensor sits on its vehicle, if known
    names:    of the vehicle and of its sensor, if the source has them
    start_ns: host time of the first packet, if known before it is read
    """

    label: str = ""
    poses: Poses | None = None
    carried: CarriedPoses | None = None
    mount: Mounting | None = None
    names: tuple[str, str] | None = None
    start_ns: int | None = None

    def __init__(self, sensor: SensorModel, *, live: bool = False) -> None:
        self.sensor = sensor
        self.live = live
        self.counts: Counter[str] = Counter()
        self.closed = False

    @abstractmethod
    def packets(self) -> Iterator[Packet]:
        """Packets in order of receipt, position packets among them; a file is read from its beginning at each call.

        Raises SourceError when the source cannot be read, PacketError for a sensor that is not supported.
        """

    @property
    def caveat(self) -> str:
        """A remark that must accompany every figure from this source or a recording of it; empty if there is none."""
        return REGRIDDED if REGRIDDED in self.sensor.name else ""

    def finish(self) -> None:
        """End a live source: `packets` then ends after the packets received so far if possible, otherwise at once."""
        self.close()

    def close(self) -> None:
        """Close files and sockets; a waiting `packets` ends. A second call does nothing."""
        self.closed = True

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()
