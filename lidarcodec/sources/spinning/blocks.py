"""Simulated units of sensors that send blocks: Velodyne and Hesai."""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cached_property
from typing import Final

import numpy as np

from lidarcodec.sensor_model import SensorModel
from lidarcodec.sensors.images import Images, Metres, Unsigned
from lidarcodec.sensors.models.blocks import BlockLayout
from lidarcodec.sensors.models.hesai_packet import HesaiSensor
from lidarcodec.sensors.models.qt128 import Qt128
from lidarcodec.sensors.models.velodyne_packet import VelodyneSensor
from lidarcodec.sources.spinning.base import Heads
from lidarcodec.sources.spinning.encoder import TURN_NS, Encoder, Numbers
from lidarcodec.units import HOUR_US

LEAD_NS: Final = 1_000_000
"""Of the first packet's time stamp, because some sensors fire before it."""
STRONGEST, LAST_AND_STRONGEST = 0x37, 0x39
"""Return modes of both makers."""
FACTORY: Final = 0x42
"""Of Hesai."""
MOTOR_RPM: Final = 600
PROTOCOLS: Final = {"xt": (6, 1, 0, 0), "qt128": (3, 2, 0, 0), "qt64": (1, 4, 0, 0)}
"""Major and minor version and two bytes without a name, as real units send them, by the beginning of the name."""
FLAGS: Final = {"qt128": 29}
YEARS_FROM: Final = {"pandar40p": 2000}
"""Year 0 of the date; else 1900."""


@dataclass(frozen=True, eq=False)
class BlockUnit:
    """A simulated Velodyne or Hesai.

    layout: `single`, which sends the strongest return, or `dual`, which sends the last and the strongest one
    seed: where its head starts; start_ns: of the drive, ns since the Unix epoch
    """

    sensor: VelodyneSensor | HesaiSensor
    layout: BlockLayout
    seed: int
    start_ns: int

    @cached_property
    def model(self) -> SensorModel:
        """The unit, with the nominal calibration of its model."""
        return replace(self.sensor.generic_sensor, origin="simulated")

    @property
    def turn_packets(self) -> int:
        """Packets of a turn, rounded up."""
        return -(-TURN_NS // self._packet_ns)

    @cached_property
    def _packet_ns(self) -> int:
        """From packet to packet."""
        return round(self._cycle_ns * self.layout.columns)

    @cached_property
    def _cycle_ns(self) -> float:
        """From column to column."""
        if isinstance(self.sensor, VelodyneSensor):
            return self.sensor.cycle_us * 1e3
        return self.sensor.cycle_ns

    @cached_property
    def _column_ns(self) -> Numbers:
        """(columns,) ns from the time stamp of a packet to its columns."""
        if isinstance(self.sensor, HesaiSensor):
            return self.sensor.column_ns(self.layout)
        columns: Numbers = np.rint(np.arange(self.layout.columns) * self._cycle_ns).astype(np.int64)
        return columns

    def heads(self, first: int, count: int) -> Heads:
        """Of the packets number `first`, which may be -1, and the `count - 1` after it."""
        numbers = np.arange(first, first + count, dtype=np.int64)
        stamps = LEAD_NS + numbers * self._packet_ns
        groups = self.layout.blocks // self.layout.group
        starts = self._column_ns[np.arange(groups) * self.layout.columns // groups]
        known = {
            "azimuth": self._encoder.azimuth((stamps[:, None] + starts).ravel()),
            "mode": np.full(count, STRONGEST if self.layout.returns == 1 else LAST_AND_STRONGEST),
        }
        known |= self._hesai(numbers, stamps) if isinstance(self.sensor, HesaiSensor) else self._velodyne(stamps)
        series: dict[str, Unsigned] = {}
        for name, (dtype, each) in self.layout.series.items():
            series[name] = known.get(name, np.zeros(count * each)).astype(dtype)
        return Heads(series, stamps)

    def origins(self, images: Images) -> tuple[Metres, Metres, Metres]:
        """Where beams begin: on the axis, if the nominal calibration has neither horizontal offsets nor corrections of
        distance. `points` of the model would say the same, but need as long as for far points."""
        calibration = self.model.calibration
        if calibration["horiz_offset_m"].any() or calibration["dist_correction_m"].any():
            return self.sensor.points(self.model, self.layout, images)
        height_m = calibration["vert_offset_m"][self.sensor.channel_of_row][:, None]
        return np.zeros((1, 1)), np.zeros((1, 1)), height_m

    def silence(self, images: Images) -> None:
        """Remove the returns of the channels of a QT128 that do not fire: all others do."""
        if not isinstance(self.sensor, Qt128):
            return
        firing = self.sensor.firing_ns(self.layout, images)
        for plane in images.planes.values():
            plane[firing == 0] = 0

    @cached_property
    def _encoder(self) -> Encoder:
        return Encoder(self.seed)

    def _velodyne(self, stamps: Numbers) -> dict[str, Numbers]:
        return {"time_us": (self.start_ns + stamps) // 1000 % HOUR_US}

    def _hesai(self, numbers: Numbers, stamps: Numbers) -> dict[str, Numbers]:
        name, count = self.sensor.name, len(numbers)
        time_us = (self.start_ns + stamps) // 1000
        protocol = next((values for begin, values in PROTOCOLS.items() if name.startswith(begin)), (0, 0, 0, 0))
        return {
            "time_us": time_us % 1_000_000,
            "date": np.array([self._date(second) for second in (time_us // 1_000_000).tolist()], np.int64).ravel(),
            "motor_speed": np.full(count, MOTOR_RPM),
            "factory": np.full(count, FACTORY),
            "udp_sequence": numbers % (1 << 32),
            "protocol": np.tile(np.array(protocol), count),
            "first_block": np.ones(count),
            "returns": np.full(count, self.layout.returns),
            "flags": np.full(count, FLAGS.get(name, 1)),
            "mode_flag": 1 - numbers % 2,
        }

    def _date(self, second: int) -> list[int]:
        date = datetime.fromtimestamp(second, UTC)
        year = date.year - YEARS_FROM.get(self.sensor.name, 1900)
        return [year, date.month, date.day, date.hour, date.minute, date.second]
