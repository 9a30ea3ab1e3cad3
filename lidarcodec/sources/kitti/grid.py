"""KITTI odometry points -> a grid of 64 rings x 2088 columns.

These points are motion compensated: only 0.3 % of them still lie on the sensor's own steps of range and azimuth. So
each point is assigned to the nearest ring and the nearest of 2088 evenly spaced columns, with its distance in steps of
2 mm. If several points fall into one cell, the nearest to the sensor is kept. That moves points by some centimetres,
near ones by more. So every figure from such a source must say "re-gridded".

Without the calibration of KITTI's sensor, the lines of the rings are fitted to a scan, whose points are stored ring by
ring.
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
"""Number of points around the seam behind the car whose order in the file may be mixed up."""
LEAST_IN_RING: Final = 100
"""Fewest points of a ring."""


def regrid(points: Points, geometry: Geometry, width: int = FRAME_COLUMNS) -> tuple[Firings, Fidelity]:
    """Firings in a grid of `width` columns, and their distances from the points. Cost: about 60 ms a scan."""
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
    """The sensor with one distance correction per laser, for making the grid and for clouds of it."""
    values: dict[str, npt.ArrayLike] = {name: sensor.calibration[name] for name in CALIBRATION_FIELDS}
    values["dist_correction_x_m"] = values["dist_correction_y_m"] = values["dist_correction_m"]
    return replace(sensor, calibration=Calibration.from_values(values))


def fit_rings(points: Points) -> SensorModel | None:
    """A sensor with elevations fitted to the rings of a scan; None if the scan does not have 64 rings.

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
