"""StatusReader: reads the sensor's calibration table from the status bytes of a stream, which may have losses.

Each type comes once in sixteen packets, so the type alone gives the number of lost packets modulo sixteen. The time
stamps give the multiple of sixteen if the sensor's clock runs. Packets whose places follow from each other are a run.
Once a run contains "UNIT#", the start of the parameter set, the place of every value in it is known. Values lost in
one round of 4160 packets are read in the next.

>>> from lidarcodec.sensors.generic import generic_sensor
>>> from lidarcodec.sensors.status import status_bytes
>>> sensor, reader = generic_sensor("HDL-64E S2"), StatusReader()
>>> for kind, value in status_bytes(sensor):
...     _ = reader.push_status(int(kind), int(value))
>>> reader.sensor.name, reader.unit.rpm
('HDL-64E S2', 600)
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Final

import numpy as np

from lidarcodec.errors import CalibrationError
from lidarcodec.sensor_model import SensorModel
from lidarcodec.sensors.hdl64 import checked
from lidarcodec.sensors.status import (
    CHECKSUM_OFFSET,
    CLOCK_SLOTS,
    CYCLE_PACKETS,
    CYCLE_TYPES,
    LASER_BYTES,
    LASER_OFFSET,
    PARAMETER_BYTES,
    PARAMETER_DTYPE,
    PARAMETERS_PER_CYCLE,
    S3_TYPES,
    STATUS_PACKETS,
    UNIT,
    WARNING_TYPE,
    StatusClock,
    calibration_of,
)
from lidarcodec.units import HOUR_US, LASERS, TAIL_OFFSET

logger = logging.getLogger(__name__)

UNKNOWN: Final = -1
MAX_LOST: Final = 512
"""Most lost packets in a row within a run; after more a new run begins."""
MAX_INTERVAL_US: Final = 5000
ANCHOR_SLOT: Final = CLOCK_SLOTS + len(UNIT) - 1
"""Place of the last byte of "UNIT#" in its cycle."""

_SLOT_OF_TYPE = [UNKNOWN] * 256
for _types in S3_TYPES.values():
    for _slot, _type in enumerate(_types, CLOCK_SLOTS):
        _SLOT_OF_TYPE[_type] = _slot
_SLOT_OF_TYPE[WARNING_TYPE] = CLOCK_SLOTS
for _slot, _type in enumerate(CYCLE_TYPES):
    _SLOT_OF_TYPE[_type] = _slot

_NEEDED = np.zeros(PARAMETER_BYTES, np.bool_)
_NEEDED[CHECKSUM_OFFSET:] = True
_NEEDED[LASER_OFFSET : LASER_OFFSET + LASERS * LASER_BYTES].reshape(LASERS, LASER_BYTES)[
    :, : PARAMETER_DTYPE.itemsize
] = True


@dataclass(frozen=True)
class UnitParameters:
    """Values of a parameter set beside the calibration; a lost value is 0.

    noise_threshold: upper and lower block; calibrated: year, month, day, hour, minute, second
    fov_cdeg: start and end of the field of view; warnings: the sensor's bits; return_mode: 0 strongest, 1 last, 2 both
    """

    noise_threshold: tuple[int, int]
    calibrated: tuple[int, int, int, int, int, int]
    humidity_percent: int
    rpm: int
    fov_cdeg: tuple[int, int]
    hours: int
    source_ip: str
    destination_ip: str
    return_mode: int
    warnings: int
    power_level: int


class StatusReader:
    """Takes the packets of a stream in the order in which they came; `sensor` is set once the table is complete.

    sensor: SensorModel with origin "stream", or None;  unit: UnitParameters, or None
    values: the latest value of each of the types H M S D N Y G T V, by letter
    failed: number of complete tables that were wrong (checksum, laser numbers);  runs: number of runs begun
    """

    def __init__(self) -> None:
        self.sensor: SensorModel | None = None
        self.unit: UnitParameters | None = None
        self.values: dict[str, int] = {}
        self.failed = 0
        self.runs = 0
        self._s3 = False
        self._place = UNKNOWN
        self._anchor = UNKNOWN
        self._gps_us = 0
        self._last = (UNKNOWN, UNKNOWN)
        self._interval_us = 0.0
        self._run = np.full(STATUS_PACKETS, UNKNOWN, np.int16)
        self._table = np.full(PARAMETER_BYTES, UNKNOWN, np.int16)

    @property
    def clock(self) -> StatusClock | None:
        """The sensor's date and time as last sent; None while a part is missing."""
        if any(letter not in self.values for letter in "HMSDNY"):
            return None
        v = self.values
        return StatusClock(
            2000 + v["Y"], v["N"], v["D"], v["H"], v["M"], v["S"], v.get("G", 0), v.get("T", 0), v.get("V", 0)
        )

    def push(self, payload: bytes) -> bool:
        """Take the next packet; True if it completed the table.

        Raises PacketError if it has not 1206 bytes. Cost: 2 us.
        """
        tail = checked(payload)[TAIL_OFFSET:]
        return self.push_status(tail[4], tail[5], int.from_bytes(tail[:4], "little"))

    def push_status(self, kind: int, value: int, gps_us: int = 0) -> bool:
        """Take the status bytes and time stamp of the next packet; True if they completed the table."""
        slot = _SLOT_OF_TYPE[kind]
        if (kind, value) == self._last and gps_us == self._gps_us:
            return False  # the same packet twice
        self._follow(slot, gps_us)
        self._last, self._gps_us = (kind, value), gps_us
        if 0 <= slot < CLOCK_SLOTS:
            self.values[chr(kind)] = value
        if self.sensor is not None or slot < CLOCK_SLOTS or self._place == UNKNOWN:
            return False
        self._s3 |= kind == WARNING_TYPE
        self._run[self._place] = value
        if self._anchor == UNKNOWN:
            if slot != ANCHOR_SLOT or not self._is_unit():
                return False
            self._anchor = (self._place - ANCHOR_SLOT) % STATUS_PACKETS
            self._take_run()
        else:
            self._take((self._place - self._anchor) % STATUS_PACKETS, value)
        return self._finish()

    def _follow(self, slot: int, gps_us: int) -> None:
        """Advance to the place of this packet, or begin a new run."""
        if self._place == UNKNOWN:
            self._place = slot
            return
        elapsed = (gps_us - self._gps_us) % HOUR_US
        lost = 0 if slot == UNKNOWN else (slot - self._place - 1) % CYCLE_PACKETS
        if lost == 0 and 0 < elapsed < MAX_INTERVAL_US:
            close = self._interval_us and elapsed < 1.5 * self._interval_us
            if close or not self._interval_us:
                self._interval_us += (elapsed - self._interval_us) / (16 if self._interval_us else 1)
        if self._interval_us and elapsed:
            by_clock = elapsed / self._interval_us - 1
            lost += round((by_clock - lost) / CYCLE_PACKETS) * CYCLE_PACKETS
            if lost < 0 or lost > MAX_LOST or abs(by_clock - lost) > CYCLE_PACKETS / 4:
                self._begin(slot)
                return
        self._place = (self._place + 1 + lost) % STATUS_PACKETS

    def _begin(self, slot: int) -> None:
        self.runs += 1
        self._run[:] = UNKNOWN
        self._anchor = UNKNOWN
        self._place = slot
        self._interval_us = 0.0

    def _is_unit(self) -> bool:
        places = np.arange(self._place - len(UNIT) + 1, self._place + 1)
        return bool(self._run[places % STATUS_PACKETS].tolist() == list(UNIT))

    def _take_run(self) -> None:
        for place in np.flatnonzero(self._run != UNKNOWN).tolist():
            self._take((place - self._anchor) % STATUS_PACKETS, int(self._run[place]))

    def _take(self, place: int, value: int) -> None:
        cycle, slot = divmod(place, CYCLE_PACKETS)
        index = cycle * PARAMETERS_PER_CYCLE + slot - CLOCK_SLOTS
        if _NEEDED[index] and self._table[index] not in (UNKNOWN, value):
            self._table[:] = UNKNOWN  # a place was wrong, or the sensor is another one
        self._table[index] = value

    def _finish(self) -> bool:
        if (self._table[_NEEDED] == UNKNOWN).any():
            return False
        data = np.maximum(self._table, 0).astype(np.uint8).tobytes()
        try:
            calibration = calibration_of(data, s3=self._s3)
        except CalibrationError as error:
            self.failed += 1
            if self.failed == 1:
                logger.warning("the calibration in the sensor's status bytes cannot be used: %s", error)
            self._table[:] = UNKNOWN
            return False
        self.sensor = SensorModel(f"HDL-64E {'S3' if self._s3 else 'S2'}", calibration, "stream")
        self.unit = _unit_parameters(data)
        return True


def _unit_parameters(data: bytes) -> UnitParameters:
    tail = data[LASER_OFFSET + (LASERS - 1) * LASER_BYTES + PARAMETER_DTYPE.itemsize : CHECKSUM_OFFSET]
    year, month, day, hour, minute, second, humidity = tail[:7]
    words = np.frombuffer(tail[7:15], "<u2").tolist()
    return UnitParameters(
        noise_threshold=(data[5], data[6]),
        calibrated=(2000 + year, month, day, hour, minute, second),
        humidity_percent=humidity,
        rpm=int.from_bytes(tail[7:9], "little", signed=True),
        fov_cdeg=(words[1], words[2]),
        hours=words[3],
        source_ip=".".join(map(str, tail[15:19])),
        destination_ip=".".join(map(str, tail[19:23])),
        return_mode=tail[23],
        warnings=data[LASER_OFFSET + PARAMETER_DTYPE.itemsize] | tail[24],
        power_level=tail[25],
    )
