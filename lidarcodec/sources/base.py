"""What every source gives: packets, the sensor they come from, and counts of what was wrong."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Protocol

from lidarcodec.packet import Packet
from lidarcodec.sensor_model import SensorModel


class Source(Protocol):
    """A source of one sensor's packets; a context manager.

    sensor: the model and calibration that were found; sensor.origin says where
    live:   True when packets come at the sensor's own pace (UDP), False when they can be read as fast as wanted
    counts: what was skipped or noticed, by cause (`truncated`, `position packets`, `kernel drops`, ...)
    """

    sensor: SensorModel
    live: bool
    counts: Counter[str]

    def packets(self) -> Iterator[Packet]:
        """Packets in order of receipt.

        Raises SourceError when the source cannot be read, PacketError for a sensor that is not supported.
        """

    def close(self) -> None:
        """Give back files and sockets; harmless when called twice, ends a `packets` that waits."""

    def __enter__(self) -> Source: ...

    def __exit__(self, *exc: object) -> None: ...
