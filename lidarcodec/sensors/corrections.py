"""Checks that a table of corrections is that of a sensor with so many lasers, for all kinds of files.

* There are as many lasers as the sensor has (64 for an HDL-64E), with ids from 0 on, each once. A file with another
  number of lasers is of another sensor: refused.
* Rotation and elevation are required; other missing values are 0 (the largest intensity 255).
* Ranges of an HDL-64E are in steps of 2 mm. Of other sensors the step is not checked: the model says it, and published
  files of the VLS-128 say 7 mm, which is wrong.
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
SENSORS = {**OTHER_SENSORS, LASERS: "an HDL-64E"}
OWN = "this model"
"""A sensor with another number of lasers, in a sentence about its file."""
REQUIRED = ("rot_correction_rad", "vert_correction_rad")
LIMITS = {"rot_correction_rad": 2 * math.pi, "vert_correction_rad": math.pi / 2}
"""Largest magnitude of angles, to detect files in a wrong unit."""


def table_of(
    lasers: Sequence[Mapping[str, Any]], range_step_m: float = RANGE_STEP_M, number: int = LASERS
) -> Calibration:
    """Calibration of lasers given as mappings of CALIBRATION_FIELDS, `laser_id` and perhaps `two_point` (bool).

    number: how many lasers the sensor has.
    Raises CalibrationError saying what is missing, double, not a number, or of another sensor.
    """
    if len(lasers) != number:
        whose = SENSORS.get(len(lasers), "another sensor")
        raise CalibrationError(
            f"it has {len(lasers)} lasers, as {whose} has, but {SENSORS.get(number, OWN)} has {number}"
        )
    if number == LASERS and not math.isclose(range_step_m, RANGE_STEP_M, rel_tol=1e-6):
        raise CalibrationError(f"its distance step is {range_step_m:g} m, but that of an HDL-64E is {RANGE_STEP_M:g} m")
    ids = [_laser_id(laser, number) for laser in lasers]
    if double := sorted({one for one in ids if ids.count(one) > 1}):
        raise CalibrationError(f"laser {double[0]} occurs twice")
    values: dict[str, list[float]] = {name: [0.0] * number for name in CALIBRATION_FIELDS}
    for one, laser in zip(ids, lasers, strict=True):
        for name, value in _laser_values(one, laser).items():
            values[name][one] = value
    return Calibration.from_values({name: np.array(column) for name, column in values.items()})


def _laser_id(laser: Mapping[str, Any], lasers: int) -> int:
    number = laser.get("laser_id")
    if isinstance(number, bool) or not isinstance(number, int):
        raise CalibrationError(f"a laser has no number: laser_id is {number!r:.40}")
    if not 0 <= number < lasers:
        raise CalibrationError(f"laser {number} does not exist: {SENSORS.get(lasers, OWN)} has 0 to {lasers - 1}")
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
