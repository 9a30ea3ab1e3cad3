"""What the packets of a simulated sensor hold beside its planes: the interface of `blocks.py` and `ouster.py`."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from lidarcodec.sensor_model import SensorModel
from lidarcodec.sensors.images import Images, Metres, PacketLayout, Sensor, Unsigned
from lidarcodec.sources.spinning.encoder import Numbers


class Heads(NamedTuple):
    """Of P packets: their series, and (P,) int64 the time stamp of each in ns since the start of the drive."""

    series: dict[str, Unsigned]
    stamps_ns: Numbers


class Unit(Protocol):
    """A simulated unit: a sensor that sends packets of one layout."""

    @property
    def sensor(self) -> Sensor:
        """Its model."""

    @property
    def layout(self) -> PacketLayout:
        """Of its packets."""

    @property
    def model(self) -> SensorModel:
        """The unit, origin `simulated`, with the calibration of its beams."""

    @property
    def turn_packets(self) -> int:
        """Packets of a turn, rounded up."""

    def heads(self, first: int, count: int) -> Heads:
        """Of the packets number `first`, which may be -1, and the `count - 1` after it."""

    def origins(self, images: Images) -> tuple[Metres, Metres, Metres]:
        """x, y, z in metres where each beam of images begins, all ranges of which are 0; (H, W) or what broadcasts."""

    def silence(self, images: Images) -> None:
        """Remove the returns of channels that do not fire."""
