"""KITTI odometry points -> a grid of 64 rings x 2088 columns, because they have no native form.

They were moved to make up for the car's motion in a turn: 0.3 % of them still fit the sensor's numbers. So a point goes
to the ring whose line it is nearest to and to the nearest of 2088 even columns, at its distance in steps of 2 mm; of
several in one cell the nearest stays. That moves points by some centimetres, more where they are near: every figure
from such a source must say "re-gridded".

Without the calibration of KITTI's sensor, the lines of the rings are fitted to a scan: its points come ring by ring.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.sensor_model import CALIBRATION_FIELDS, Calibration, SensorModel
from lidarcodec.sensors import generic_sensor
from lidarcodec.sources.kitti.inversion import MAX_NATIVE, Fidelity, Firings, Geometry, fidelity_of, fill
from lidarcodec.sources.kitti.points import Points
from lidarcodec.units import AZIMUTH_TURN, FRAME_COLUMNS, LASERS

SMOOTHING: Final = 32
"""Points around the seam behind the car in which the order of a ring may be mixed up."""
LEAST_IN_RING: Final = 100
"""A ring of fewer points is no ring."""


def regrid(points: Points, geometry: Geometry, width: int = FRAME_COLUMNS) -> tuple[Firings, Fidelity]:
    """A grid of `width` columns, and how far it is from the points. Cost: about 60 ms a scan."""
    laser = geometry.nearest_laser(geometry.radius(points), points[:, 2])
    rotation, distance = geometry.native(points, laser)
    column = np.rint(rotation * (width / AZIMUTH_TURN)).astype(np.intp) % width
    azimuth = np.rint(np.arange(width) * (AZIMUTH_TURN / width)).astype(np.int64) % AZIMUTH_TURN
    native = np.rint(distance)
    there = (native >= 1) & (native <= MAX_NATIVE)
    again = geometry.project(azimuth[column].astype(np.float64), native, laser)
    away_mm = np.linalg.norm(again - points[:, :3], axis=1) * 1000.0
    firings, kept = fill(azimuth, column[there], laser[there], native[there], points[there, 3])
    same = there & (np.rint(again * 1000.0) == np.rint(points[:, :3] * 1000.0)).all(axis=1)
    return firings, fidelity_of(len(points), same, there & (away_mm <= 1.0), away_mm[there], kept)


def without_two_point_correction(sensor: SensorModel) -> SensorModel:
    """The sensor with one distance correction per laser: what the grid is made with, and its clouds are seen with."""
    values: dict[str, npt.ArrayLike] = {name: sensor.calibration[name] for name in CALIBRATION_FIELDS}
    values["dist_correction_x_m"] = values["dist_correction_y_m"] = values["dist_correction_m"]
    return replace(sensor, calibration=Calibration.from_values(values))


def fit_rings(points: Points) -> SensorModel | None:
    """A sensor whose rings look where those of a scan do; None if it has not 64 of them.

    A ring goes once round from straight ahead, and has one seam behind the car, where the angle jumps from 180 to -180
    degrees. Its points lie on a line z = r tan(elevation) + height; heights are those of the generic table, because on
    the lower rings, seen at one distance only, nothing would tell the two apart. Measured, the rings of an odometry
    scan come as near to its points as those of the sensor's own calibration (10 mm median, 50 mm at 99 %).
    """
    angle = np.arctan2(points[:, 1], points[:, 0])
    seams = np.flatnonzero(np.diff(angle) < -np.pi)
    if not len(seams):
        return None
    seams = seams[np.concatenate([[True], np.diff(seams) > SMOOTHING])]
    if len(seams) != LASERS:
        return None
    edges = [0]
    for seam, after in zip(seams[:-1].tolist(), seams[1:].tolist(), strict=True):
        edges.append(seam + 1 + int(np.count_nonzero(angle[seam + 1 : after + 1] < 0.0)))
    edges.append(len(points))
    if np.diff(edges).min() < LEAST_IN_RING:
        return None
    rings = np.repeat(np.arange(LASERS), np.diff(edges))
    height = generic_sensor().calibration["vert_offset_m"][generic_sensor().laser_of_ring]
    r = np.hypot(points[:, 0], points[:, 1])
    elevation = np.zeros(LASERS)
    for _ in range(2):  # the height above the origin is that of the offset turned by the elevation
        slope = (points[:, 2] - (height / np.cos(elevation))[rings]) / np.maximum(r, 0.1)
        elevation = np.array([np.arctan(np.median(part)) for part in np.split(slope, edges[1:-1])])
    if not (np.diff(elevation) < 0.0).all():
        return None
    calibration = Calibration.from_values({"vert_correction_rad": elevation, "vert_offset_m": height})
    return SensorModel("HDL-64E", calibration, "generic")
