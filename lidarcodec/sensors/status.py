"""The status bytes of an HDL-64E S2 and S3: a type and a value in every packet, and the calibration that they carry.

Sixteen packets make a cycle: nine with the types H M S D N Y G T V (clock, GPS, temperature, firmware) and seven with
the types 1 to 7, which carry one byte each of the parameter set. 260 cycles = 4160 packets carry its 1820 bytes:

    0-4        "UNIT#"
    5, 6       noise threshold of the upper and of the lower block
    7+28k      laser k = 0..63: PARAMETER_DTYPE (21 bytes), 1 byte of warning bits, 6 reserved
    1792-1798  (the reserved bytes of laser 63) calibration time: year-2000 month day hour minute second; humidity %
    1799-1804  i2 motor speed, u2 and u2 start and end of the field of view in 0.01 degree
    1805-1817  u2 hours of operation, 4 bytes source and 4 destination IP, return mode, warning bits, power level
    1818       u2 checksum: on an S3 the CRC-16 of the lasers' values, on an S2 the number 1820

An S3 sends a laser's warning bits with the type W instead of 1, and some of the last values with types of their own
(0xF8-0xFF) in place of the digit: only the place in the cycle is used here, and it is the same.

HDL-64E S3 user manual rev. K, appendix E (pages 32-39); velodyne-decoder reads the same layout.

>>> from lidarcodec.sensors.generic import generic_sensor
>>> cycle = status_bytes(generic_sensor("HDL-64E S2"))
>>> cycle.shape, bytes(cycle[:16, 0]).decode(), bytes(cycle[9:14, 1]).decode()
((4160, 2), 'HMSDNYGTV1234567', 'UNIT#')
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import CalibrationError
from lidarcodec.sensor_model import CALIBRATION_FIELDS, Calibration, SensorModel
from lidarcodec.units import LASERS

CYCLE_TYPES: Final = b"HMSDNYGTV1234567"
CYCLE_PACKETS: Final = len(CYCLE_TYPES)
CLOCK_SLOTS: Final = 9
PARAMETERS_PER_CYCLE: Final = CYCLE_PACKETS - CLOCK_SLOTS
PARAMETER_BYTES: Final = 1820
STATUS_PACKETS: Final = PARAMETER_BYTES // PARAMETERS_PER_CYCLE * CYCLE_PACKETS
"""4160 packets carry the whole parameter set, 1.2 s."""
UNIT: Final = b"UNIT#"
LASER_OFFSET: Final = 7
LASER_BYTES: Final = 28
CHECKSUM_OFFSET: Final = PARAMETER_BYTES - 2
WARNING_TYPE: Final = ord("W")
S3_TYPES: Final = {
    257: (0xFE, 0xFF, 0xFC, 0xFD, 0xFA, 0xFB, 0x37),
    259: (0x31, 0x32, 0xF9, 0x34, 0xF8, 0x36, 0x37),
}
"""Types of the seven parameters in those of the 260 cycles where an S3 does not send digits."""

PARAMETER_DTYPE = np.dtype(
    [
        ("laser_id", "u1"),
        ("vert_correction", "<i2"),
        ("rot_correction", "<i2"),
        ("dist_correction", "<i2"),
        ("dist_correction_x", "<i2"),
        ("dist_correction_y", "<i2"),
        ("vert_offset", "<i2"),
        ("horiz_offset", "<i2"),
        ("focal_distance", "<i2"),
        ("focal_slope", "<i2"),
        ("min_intensity", "u1"),
        ("max_intensity", "u1"),
    ]
)
"""A laser's 21 bytes: angles in 0.01 degree, lengths in millimetres, slope in tenths."""
STEPS: Final[dict[str, tuple[str, float]]] = {
    "vert_correction": ("vert_correction_rad", math.radians(0.01)),
    "rot_correction": ("rot_correction_rad", math.radians(0.01)),
    "dist_correction": ("dist_correction_m", 1e-3),
    "dist_correction_x": ("dist_correction_x_m", 1e-3),
    "dist_correction_y": ("dist_correction_y_m", 1e-3),
    "vert_offset": ("vert_offset_m", 1e-3),
    "horiz_offset": ("horiz_offset_m", 1e-3),
    "focal_distance": ("focal_distance_m", 1e-3),
    "focal_slope": ("focal_slope", 0.1),
    "min_intensity": ("min_intensity", 1.0),
    "max_intensity": ("max_intensity", 1.0),
}
"""Calibration field and step of each value."""


@dataclass(frozen=True)
class StatusClock:
    """The first nine values of a cycle: date, time and status. Without GPS the date starts in 2000.

    gps: b"A" NMEA and pulse, b"V" NMEA only, b"P" pulse only, 0 neither
    """

    year: int = 2000
    month: int = 1
    day: int = 1
    hour: int = 0
    minute: int = 0
    second: int = 0
    gps: int = 0
    temperature_c: int = 25
    firmware: int = 0x47

    def values(self) -> bytes:
        """The nine values, in the order H M S D N Y G T V."""
        fields = (self.hour, self.minute, self.second, self.day, self.month, self.year - 2000)
        return bytes((*fields, self.gps, self.temperature_c, self.firmware))


def crc16(data: bytes) -> int:
    """CRC-16 of an S3's parameter set: polynomial 0x8005, most significant bit first, start 0, nothing inverted."""
    register = 0
    for byte in data:
        register ^= byte << 8
        for _ in range(8):
            register = (register << 1 ^ 0x8005 if register & 0x8000 else register << 1) & 0xFFFF
    return register


def laser_values(parameters: bytes) -> bytes:
    """The bytes that an S3's checksum covers: the 21 bytes of each laser without its id."""
    starts = range(LASER_OFFSET, LASER_OFFSET + LASERS * LASER_BYTES, LASER_BYTES)
    return b"".join(parameters[start + 1 : start + PARAMETER_DTYPE.itemsize] for start in starts)


def parameter_bytes(sensor: SensorModel, *, s3: bool = False) -> bytes:
    """The 1820 bytes of a sensor's parameter set, with the checksum of an S2 or S3.

    The form is coarser than a calibration file: 0.01 degree and 1 mm.
    Raises CalibrationError if a value does not fit (angles beyond 327.67 degrees, lengths beyond 32.767 m).
    """
    table = np.zeros(LASERS, PARAMETER_DTYPE)
    table["laser_id"] = np.arange(LASERS)
    for name, (field, step) in STEPS.items():
        steps = np.rint(sensor.calibration[field] / step)
        limits = np.iinfo(PARAMETER_DTYPE[name])
        if not np.all((steps >= limits.min) & (steps <= limits.max)):
            raise CalibrationError(f"{field} has a value that the status bytes cannot carry")
        table[name] = steps
    data = np.zeros(PARAMETER_BYTES, np.uint8)
    data[:LASER_OFFSET] = np.frombuffer(UNIT + b"\x18\x18", np.uint8)
    lasers = data[LASER_OFFSET : LASER_OFFSET + LASERS * LASER_BYTES].reshape(LASERS, LASER_BYTES)
    lasers[:, : PARAMETER_DTYPE.itemsize] = table.view(np.uint8).reshape(LASERS, -1)
    tail = (
        *(11, 9, 26, 12, 0, 0, 25),  # calibrated 2011-09-26 12:00, humidity 25 %
        *(*(600).to_bytes(2, "little"), 0, 0, *(36000).to_bytes(2, "little")),  # 600 rpm, the whole turn
        *(100, 0, 192, 168, 3, 43, 192, 168, 3, 255, 0, 0, 0xA8),
    )
    data[CHECKSUM_OFFSET - len(tail) : CHECKSUM_OFFSET] = tail
    checksum = crc16(laser_values(data.tobytes())) if s3 else PARAMETER_BYTES
    return data[:CHECKSUM_OFFSET].tobytes() + checksum.to_bytes(2, "little")


def status_bytes(
    sensor: SensorModel,
    start: int = 0,
    packets: int = STATUS_PACKETS,
    *,
    s3: bool = False,
    clock: StatusClock | None = None,
) -> npt.NDArray[np.uint8]:
    """(packets, 2) uint8, status type and value of consecutive packets, from place `start` of the 4160 on.

    The clock stands still: a player of the stream overwrites the values of types H M S D N Y.
    Raises CalibrationError if the calibration does not fit the form.
    """
    places = (start + np.arange(packets)) % STATUS_PACKETS
    cycle, slot = places // CYCLE_PACKETS, places % CYCLE_PACKETS
    types = np.frombuffer(CYCLE_TYPES, np.uint8)[slot]
    data = np.frombuffer(parameter_bytes(sensor, s3=s3), np.uint8)
    parameter = data[cycle * PARAMETERS_PER_CYCLE + np.maximum(slot - CLOCK_SLOTS, 0)]
    fixed = np.zeros(CYCLE_PACKETS, np.uint8)
    fixed[:CLOCK_SLOTS] = np.frombuffer((clock or StatusClock()).values(), np.uint8)
    if s3:
        types = np.where((slot == CLOCK_SLOTS) & (cycle % 4 == 0) & (cycle >= 4) & (cycle < 256), WARNING_TYPE, types)
        for number, special in S3_TYPES.items():
            own = np.frombuffer(bytes(CLOCK_SLOTS) + bytes(special), np.uint8)[slot]
            types = np.where((cycle == number) & (slot >= CLOCK_SLOTS), own, types)
    values = np.where(slot < CLOCK_SLOTS, fixed[slot], parameter)
    return np.stack([types, values], axis=1).astype(np.uint8)


def calibration_of(parameters: bytes, *, s3: bool) -> Calibration:
    """Calibration in the 1820 bytes of a parameter set; only an S3's checksum must be a CRC.

    Raises CalibrationError if the checksum is wrong, or laser ids are not 0 to 63: the sensor sends none, or not all
    bytes are in their places.
    """
    checksum = int.from_bytes(parameters[CHECKSUM_OFFSET:], "little")
    if checksum != crc16(laser_values(parameters)) and (s3 or checksum != PARAMETER_BYTES):
        raise CalibrationError(f"the checksum of the status bytes does not match: {checksum:#06x}")
    area = np.frombuffer(parameters, np.uint8)[LASER_OFFSET : LASER_OFFSET + LASERS * LASER_BYTES]
    lasers = np.ascontiguousarray(area.reshape(LASERS, LASER_BYTES)[:, : PARAMETER_DTYPE.itemsize])
    table = lasers.view(PARAMETER_DTYPE)[:, 0]
    if not np.array_equal(table["laser_id"], np.arange(LASERS)):
        raise CalibrationError("the status bytes do not hold a calibration: their laser numbers are not 0 to 63")
    values = {field: table[name].astype(np.float64) * step for name, (field, step) in STEPS.items()}
    near = (values["dist_correction_x_m"] == 0) | (values["dist_correction_y_m"] == 0)
    for field in ("dist_correction_x_m", "dist_correction_y_m"):
        values[field] = np.where(near, values["dist_correction_m"], values[field])
    return Calibration.from_values({name: values[name] for name in CALIBRATION_FIELDS})
