"""Checks that a table of corrections is that of an HDL-64E, for all kinds of files.

* There are 64 lasers with ids 0-63, each once. A file with another number of lasers is of another sensor: refused.
* Rotation and elevation are required; other missing values are 0 (the largest intensity 255).
* Ranges are in steps of 2 mm.
* two-point distance correction: a laser whose X or Y correction is missing or 0, or whose
  `two_pt_correction_available` is false, has none: its X and Y corrections are set to the distance correction, which
  means the same and needs no flag. (A ROS file may say true and hold zeros, the 64e_utexas one does: zeros would pull
  near points in by the whole correction.)
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from lidarcodec.errors import CalibrationError
from lidarcodec.sensor_model import CALIBRATION_FIELDS, Calibration
from lidarcodec.units import LASERS, RANGE_STEP_M

OTHER_SENSORS = {16: "a VLP-16 or Puck Hi-Res", 32: "an HDL-32E or VLP-32", 128: "a VLS-128"}
"""Number of lasers -> sensors."""
REQUIRED = ("rot_correction_rad", "vert_correction_rad")
LIMITS = {"rot_correction_rad": 2 * math.pi, "vert_correction_rad": math.pi / 2}
"""Largest magnitude of angles, to detect files in a wrong unit."""


def table_of(lasers: Sequence[Mapping[str, Any]], range_step_m: float = RANGE_STEP_M) -> Calibration:
    """Calibration of 64 lasers given as mappings of CALIBRATION_FIELDS, `laser_id` and perhaps `two_point` (bool).

    Raises CalibrationError saying what is missing, double, not a number, or of another sensor.
    """
    if len(lasers) != LASERS:
        whose = OTHER_SENSORS.get(len(lasers), "another sensor")
        raise CalibrationError(f"it has {len(lasers)} lasers, like {whose}: an HDL-64E has {LASERS}")
    if not math.isclose(range_step_m, RANGE_STEP_M, rel_tol=1e-6):
        raise CalibrationError(f"its distance step is {range_step_m:g} m: an HDL-64E has {RANGE_STEP_M:g} m")
    ids = [_laser_id(laser) for laser in lasers]
    if double := sorted({number for number in ids if ids.count(number) > 1}):
        raise CalibrationError(f"laser {double[0]} occurs twice")
    values: dict[str, list[float]] = {name: [0.0] * LASERS for name in CALIBRATION_FIELDS}
    for number, laser in zip(ids, lasers, strict=True):
        for name, value in _laser_values(number, laser).items():
            values[name][number] = value
    return Calibration.from_values({name: np.array(column) for name, column in values.items()})


def _laser_id(laser: Mapping[str, Any]) -> int:
    number = laser.get("laser_id")
    if isinstance(number, bool) or not isinstance(number, int):
        raise CalibrationError(f"a laser has no number: laser_id is {number!r:.40}")
    if not 0 <= number < LASERS:
        raise CalibrationError(f"laser {number} does not exist: an HDL-64E has 0 to {LASERS - 1}")
    return number


def _laser_values(number: int, laser: Mapping[str, Any]) -> dict[str, float]:
    values: dict[str, float] = {}
    for name in CALIBRATION_FIELDS:
        given = laser.get(name)
        if given is None and name in REQUIRED:
            raise CalibrationError(f"laser {number} has no {name.removesuffix('_rad')}")
        default = 255.0 if name == "max_intensity" else 0.0
        try:
            value = default if given is None else float(given)
        except (TypeError, ValueError, OverflowError):
            value = math.nan
        if isinstance(given, bool) or not abs(value) <= LIMITS.get(name, math.inf) or math.isinf(value):
            raise CalibrationError(f"laser {number}: {name} must be a number in a possible range, not {given!r:.40}")
        values[name] = math.floor(value) if name.endswith("intensity") else value
    near = (values["dist_correction_x_m"], values["dist_correction_y_m"])
    if 0.0 in near or laser.get("two_point", True) is False:
        values["dist_correction_x_m"] = values["dist_correction_y_m"] = values["dist_correction_m"]
    return values
