"""SensorModel: a sensor's units and per-laser calibration, with a hash.

Calibration values are integers in steps of 1e-8 rad and 1e-7 m, fine enough for every published file. So a file and
the table sent in a message give the same hash.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import CalibrationError, SettingsError
from lidarcodec.units import LASERS, RANGE_STEP_M

ANGLE_UNIT_RAD = 1e-8
LENGTH_UNIT_M = 1e-7
SLOPE_UNIT = 1e-6
MAX_LASERS = 128
HDL64E = "hdl64e"
POINTCLOUD2 = "pointcloud2"

Convention = Literal["ros", "veloview"]
Origin = Literal["given", "beside", "stream", "generic", "message", "simulated"]

CALIBRATION_FIELDS: dict[str, float] = {
    "rot_correction_rad": ANGLE_UNIT_RAD,
    "vert_correction_rad": ANGLE_UNIT_RAD,
    "dist_correction_m": LENGTH_UNIT_M,
    "dist_correction_x_m": LENGTH_UNIT_M,
    "dist_correction_y_m": LENGTH_UNIT_M,
    "vert_offset_m": LENGTH_UNIT_M,
    "horiz_offset_m": LENGTH_UNIT_M,
    "focal_distance_m": LENGTH_UNIT_M,
    "focal_slope": SLOPE_UNIT,
    "min_intensity": 1.0,
    "max_intensity": 1.0,
}
"""Name of each per-laser value -> the step in which it is stored and sent."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """Per-laser calibration: `table` is (11, H) int32, a row per entry of CALIBRATION_FIELDS, in its steps.

    H is the number of lasers, 1 to 128.
    """

    table: npt.NDArray[np.int32]

    def __post_init__(self) -> None:
        shape = self.table.shape
        if len(shape) != 2 or shape[0] != len(CALIBRATION_FIELDS) or not 1 <= shape[1] <= MAX_LASERS:
            raise CalibrationError(
                f"a calibration table is int32(11, 1 to {MAX_LASERS}), not {self.table.dtype}{shape}"
            )
        if self.table.dtype != np.int32:
            raise CalibrationError(f"a calibration table is int32, not {self.table.dtype}")
        self.table.flags.writeable = False

    @classmethod
    def from_values(cls, values: dict[str, npt.ArrayLike]) -> Calibration:
        """Calibration from float values by field name, (H,) each. Missing fields are 0, max_intensity 255.

        H is the length of the longest field, or 64 if all are single numbers.
        Raises CalibrationError for an unknown field, NaN, a value out of range, or fields of different lengths.
        """
        lasers = max((np.size(value) for value in values.values() if np.ndim(value)), default=LASERS)
        if any(np.ndim(value) and np.shape(value) != (lasers,) for value in values.values()):
            raise CalibrationError(f"the fields of a calibration of {lasers} lasers need {lasers} values each")
        table = np.zeros((len(CALIBRATION_FIELDS), lasers), np.int32)
        for row, (name, step) in enumerate(CALIBRATION_FIELDS.items()):
            given = np.asarray(values.get(name, 255.0 if name == "max_intensity" else 0.0), np.float64)
            steps = np.rint(np.broadcast_to(given, (lasers,)) / step)
            if not np.all(np.abs(steps) < 2**31):  # also catches NaN
                raise CalibrationError(f"calibration value {name} is out of range")
            table[row] = steps.astype(np.int32)
        unknown = set(values) - set(CALIBRATION_FIELDS)
        if unknown:
            known = ", ".join(CALIBRATION_FIELDS)
            raise CalibrationError(f"unknown calibration fields: {', '.join(sorted(unknown))}; there are {known}")
        return cls(table)

    def __getitem__(self, name: str) -> npt.NDArray[np.float64]:
        """(H,) float64 values of one field by hardware laser id, radians or metres as its name says."""
        row = list(CALIBRATION_FIELDS).index(name)
        values: npt.NDArray[np.float64] = self.table[row] * CALIBRATION_FIELDS[name]
        return values


@dataclass(frozen=True, eq=False)
class SensorModel:
    """A sensor: name, calibration, origin of the calibration, convention of Cartesian coordinates, and range step.

    The convention `ros` turns the vertical offset by the elevation, `veloview` does not (cloud.py).
    model: as in `--model`: `hdl64e`, or the name of a sensor in `lidarcodec.sensors.models`
    description: what the sensor says of itself (the metadata JSON of an Ouster); empty where there is none
    """

    name: str
    calibration: Calibration
    origin: Origin = "given"
    convention: Convention = "ros"
    range_step_m: float = RANGE_STEP_M
    model: str = HDL64E
    description: bytes = b""

    @property
    def rows(self) -> int:
        """Rows of its images, H."""
        return int(self.calibration.table.shape[1])

    @property
    def is_hdl64e(self) -> bool:
        """Whether it is an HDL-64E, whose messages have sections of their own."""
        return self.model == HDL64E

    @property
    def is_cloud(self) -> bool:
        """Whether its packets are point clouds, `sensor_msgs/PointCloud2` messages."""
        return self.model == POINTCLOUD2

    def only_hdl64e(self, what: str) -> None:
        """Raise SettingsError if it is another sensor. what: that takes only an HDL-64E, such as `annotate`"""
        if not self.is_hdl64e:
            raise SettingsError(f"{what} works only with an HDL-64E, but this source is a {self.name}")

    def no_cloud(self, what: str) -> None:
        """Raise SettingsError if it sends point clouds. what: that takes only packets, such as `annotate`"""
        if self.is_cloud:
            raise SettingsError(f"{what} takes packets of a spinning sensor, but this source has point clouds")

    @cached_property
    def laser_of_ring(self) -> npt.NDArray[np.intp]:
        """(H,) hardware laser id of each row; row 0 looks highest (ties keep the order of the ids)."""
        order = np.argsort(-self.calibration["vert_correction_rad"], kind="stable")
        order.flags.writeable = False
        return order

    @cached_property
    def ring_of_laser(self) -> npt.NDArray[np.intp]:
        """(H,) row of each hardware laser id."""
        rings = np.empty(len(self.laser_of_ring), np.intp)
        rings[self.laser_of_ring] = np.arange(len(rings))
        rings.flags.writeable = False
        return rings

    @cached_property
    def hash(self) -> str:
        """16 hex digits that identify sensor and calibration, the same on every machine."""
        of = self.name.encode() + b"\0" + self.calibration.table.astype("<i4").tobytes()
        if not self.is_hdl64e:
            of += b"\0" + self.model.encode() + b"\0" + self.description
        return hashlib.sha256(of).hexdigest()[:16]

    def with_convention(self, convention: Convention) -> SensorModel:
        """This sensor with another Cartesian convention."""
        return replace(self, convention=convention)
