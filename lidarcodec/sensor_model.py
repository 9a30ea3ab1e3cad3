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

from lidarcodec.errors import CalibrationError
from lidarcodec.units import LASERS, RANGE_STEP_M

ANGLE_UNIT_RAD = 1e-8
LENGTH_UNIT_M = 1e-7
SLOPE_UNIT = 1e-6

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
    """Per-laser calibration: `table` is (11, 64) int32, a row per entry of CALIBRATION_FIELDS, in its steps."""

    table: npt.NDArray[np.int32]

    def __post_init__(self) -> None:
        if self.table.shape != (len(CALIBRATION_FIELDS), LASERS) or self.table.dtype != np.int32:
            raise CalibrationError(f"a calibration table is int32(11, 64), not {self.table.dtype}{self.table.shape}")
        self.table.flags.writeable = False

    @classmethod
    def from_values(cls, values: dict[str, npt.ArrayLike]) -> Calibration:
        """Calibration from float values by field name, (64,) each. Missing fields are 0, max_intensity 255.

        Raises CalibrationError for an unknown field, NaN, or a value out of range.
        """
        table = np.zeros((len(CALIBRATION_FIELDS), LASERS), np.int32)
        for row, (name, step) in enumerate(CALIBRATION_FIELDS.items()):
            given = np.asarray(values.get(name, 255.0 if name == "max_intensity" else 0.0), np.float64)
            steps = np.rint(np.broadcast_to(given, (LASERS,)) / step)
            if not np.all(np.abs(steps) < 2**31):  # also catches NaN
                raise CalibrationError(f"calibration value {name} is out of range")
            table[row] = steps.astype(np.int32)
        unknown = set(values) - set(CALIBRATION_FIELDS)
        if unknown:
            raise CalibrationError(f"unknown calibration fields: {', '.join(sorted(unknown))}")
        return cls(table)

    def __getitem__(self, name: str) -> npt.NDArray[np.float64]:
        """(64,) float64 values of one field by hardware laser id, radians or metres as its name says."""
        row = list(CALIBRATION_FIELDS).index(name)
        values: npt.NDArray[np.float64] = self.table[row] * CALIBRATION_FIELDS[name]
        return values


@dataclass(frozen=True, eq=False)
class SensorModel:
    """A sensor: name, calibration, origin of the calibration, convention of Cartesian coordinates, and range step.

    The convention `ros` turns the vertical offset by the elevation, `veloview` does not (cloud.py).
    """

    name: str
    calibration: Calibration
    origin: Origin = "given"
    convention: Convention = "ros"
    range_step_m: float = RANGE_STEP_M

    @cached_property
    def laser_of_ring(self) -> npt.NDArray[np.intp]:
        """(64,) hardware laser id of each row; row 0 looks highest (ties keep the order of the ids)."""
        order = np.argsort(-self.calibration["vert_correction_rad"], kind="stable")
        order.flags.writeable = False
        return order

    @cached_property
    def ring_of_laser(self) -> npt.NDArray[np.intp]:
        """(64,) row of each hardware laser id."""
        rings = np.empty(LASERS, np.intp)
        rings[self.laser_of_ring] = np.arange(LASERS)
        rings.flags.writeable = False
        return rings

    @cached_property
    def hash(self) -> str:
        """16 hex digits that identify sensor and calibration, the same on every machine."""
        digest = hashlib.sha256(self.name.encode() + b"\0" + self.calibration.table.astype("<i4").tobytes())
        return digest.hexdigest()[:16]

    def with_convention(self, convention: Convention) -> SensorModel:
        """This sensor with another Cartesian convention."""
        return replace(self, convention=convention)
