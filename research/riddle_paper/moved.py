"""The scan before as points, moved by the ego motion to where they are now: the paper's temporal context.

A beam of an HDL-64E does not start at the sensor's centre, but up to 0.2 m above it. So a point is looked for in the
direction, from the centre, in which the cell's own point would lie at the range of the last valid one before it; and
ranges are those along the cell's beam.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.cloud import xyz_of
from lidarcodec.errors import LidarCodecError
from lidarcodec.frame import Frame
from lidarcodec.motion.motion import Motion
from lidarcodec.ranges.image.canvas import level_offsets
from lidarcodec.sensor_model import SensorModel
from lidarcodec.units import RANGE_STEP_M

NEIGHBOURS: Final = 100
"""As the paper's main text has it; its supplement says 50."""
_LEAST_M: Final = 0.5
"""A range too short to have a direction."""
_DEFAULT_M: Final = 10.0
"""Where to look when nothing is known."""

Floats = npt.NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Seen:
    """The K points nearest to each of N beams, nearest first; (N, K) each.

    azimuth, elevation: float32, radians, as seen from the beam; ranges_m: float32, along it; valid: bool
    """

    azimuth: Floats
    elevation: Floats
    ranges_m: Floats
    valid: npt.NDArray[np.bool_]


class MovedPoints:
    """Points of a scan, as decoded, where a motion puts them.

    ranges:  (64, W) uint16 of `frame`, as a decoder has them
    motion:  T_current_previous; count: neighbours for each beam
    Raises LidarCodecError if `count` is not at least 1.
    """

    def __init__(self, frame: Frame, ranges: npt.NDArray[np.uint16], motion: Motion, count: int = NEIGHBOURS) -> None:
        from small_gicp import KdTree

        if count < 1:
            raise LidarCodecError(f"{count} neighbours: at least 1 is needed")
        sent = frame.with_(range=ranges, keep=None)
        chosen = np.flatnonzero(ranges.T)
        points = np.stack([axis.ravel()[chosen] for axis in xyz_of(sent)], axis=1)
        points = points @ motion.matrix[:3, :3].T + motion.matrix[:3, 3]
        far = np.linalg.norm(points, axis=1)
        points, self._far_m = points[far > _LEAST_M], far[far > _LEAST_M]
        self._count = count
        self._beams = _Beams(frame.sensor)
        self._azimuth, self._elevation = _direction(points)
        self._tree = KdTree(np.ascontiguousarray(points / self._far_m[:, None])) if len(points) else None

    def nearest(self, rows: npt.NDArray[np.intp], azimuth: Floats, before_m: Floats) -> Seen:
        """The points nearest in direction to beams of N cells.

        rows: (N,); azimuth: (N,) radians, rotation correction taken off; before_m: (N,) metres, where to look
        """
        shape = (len(rows), self._count)
        if self._tree is None or not len(rows):
            zeros = np.zeros(shape, np.float32)
            return Seen(zeros, zeros, zeros, np.zeros(shape, np.bool_))
        targets = self._beams.points(rows, azimuth.astype(np.float64), before_m.astype(np.float64))
        targets /= np.linalg.norm(targets, axis=1, keepdims=True)
        held = min(self._count, len(self._far_m))
        found = np.zeros(shape, np.intp)
        found[:, :held] = self._tree.batch_knn_search(targets, held)[0].astype(np.intp).reshape(-1, held)
        valid = np.zeros(shape, np.bool_)
        valid[:, :held] = True
        to_azimuth, to_elevation = _direction(targets)
        turned = self._azimuth[found] - to_azimuth[:, None]
        turned -= 2 * np.pi * np.rint(turned / (2 * np.pi))
        risen = self._elevation[found] - to_elevation[:, None]
        ranges = self._beams.ranges(rows, self._far_m[found])
        return Seen(
            np.where(valid, turned, 0).astype(np.float32),
            np.where(valid, risen, 0).astype(np.float32),
            np.where(valid, ranges, 0).astype(np.float32),
            valid,
        )


class _Beams:
    """The beams of a sensor, by row: see `lidarcodec.cloud` for the formulas (the `ros` form)."""

    def __init__(self, sensor: SensorModel) -> None:
        lasers, table = sensor.laser_of_ring, sensor.calibration
        vertical = table["vert_correction_rad"][lasers]
        self._cos, self._sin = np.cos(vertical), np.sin(vertical)
        self._up, self._side = table["vert_offset_m"][lasers], table["horiz_offset_m"][lasers]
        # what the image's level leaves out: the correction that all rows have
        self._zero_m = table["dist_correction_m"][lasers] - level_offsets(sensor) * RANGE_STEP_M

    def points(
        self, rows: npt.NDArray[np.intp], azimuth: npt.NDArray[np.float64], ranges_m: npt.NDArray[np.float64]
    ) -> npt.NDArray[np.float64]:
        """(N, 3) metres, the point of each beam at a range of the image; a default range where none is given."""
        along = np.where(ranges_m > 0, ranges_m, _DEFAULT_M) + self._zero_m[rows]
        along = np.maximum(along, _LEAST_M)
        flat = along * self._cos[rows] - self._up[rows] * self._sin[rows]
        cos, sin, side = np.cos(azimuth), np.sin(azimuth), self._side[rows]
        height = along * self._sin[rows] + self._up[rows] * self._cos[rows]
        return np.stack([flat * cos + side * sin, side * cos - flat * sin, height], axis=1)

    def ranges(self, rows: npt.NDArray[np.intp], far_m: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """(N, K) metres on the image's scale, at which beams of rows (N,) reach distances (N, K) from the centre."""
        offset = (self._up**2 + self._side**2)[rows][:, None]
        along = np.sqrt(np.maximum(far_m**2 - offset, 0.0)) - self._zero_m[rows][:, None]
        ranges: npt.NDArray[np.float64] = np.maximum(along, 0.0)
        return ranges


def _direction(points: npt.NDArray[np.float64]) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """(N,) azimuth, growing clockwise as the sensor turns, and (N,) elevation of points (N, 3), radians."""
    return -np.arctan2(points[:, 1], points[:, 0]), np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1]))
