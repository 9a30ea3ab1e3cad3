"""The range image of a point cloud that came as a message, for viewers that compute points themselves.

A message says where points are, and not by which beams. The rows and columns of the frame are taken, with the usual
direction of the points of each, if every point is drawn close to its place by them. Otherwise, as with points in no
order, the rows are the directions up and down that most points are near to, and the columns are even steps of a turn.
A point that is not drawn close to its place is left out, so a viewer sees fewer points, but none in a wrong place.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt

from lidarcodec.frame import Frame
from lidarcodec.sensors.clouds.message import MAX_POINTS, CloudMessage, read_message
from lidarcodec.sensors.clouds.points import payload_of
from lidarcodec.sensors.clouds.values import intensity_of
from lidarcodec.sensors.clouds.view import view_of
from lidarcodec.units import AZIMUTH_TURN
from lidarcodec_server.live.ring_geometry import MAX_U16, RingGeometry

FARTHEST_M: Final = 1048.0
"""Points further away are not shown: one of them would take the steps of all others."""
STEP_M: Final = 0.004
ROWS: Final = 128
COLUMNS: Final = (2048, 4096)
"""Columns of a turn for points in no order: of few points, and of more than `MANY`."""
MANY: Final = 30_000
NEAR_M: Final = 0.1
NEAR: Final = 0.004
"""Points are drawn by rows and columns of the frame if each is so many metres, and that part of its range, or less
from its place."""
CLOSE_M: Final = 0.15
CLOSE: Final = 0.02
"""The same for a point in rows that are made for the image; others are left out."""
SAME_RAD: Final = 0.0005
"""Directions of a row that differ by less are the same: a viewer is not told again."""
_MOST_COLUMNS: Final = 12_288
"""Of the page."""
_WHOLE_TURN: Final = 0.98
_BETWEEN_LINES: Final = 0.0007
"""Radians between two lines of points; beams are 0.1 degree apart or more."""
_WIDEST_LINE: Final = 0.002

Floats = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]


class CloudImage(NamedTuple):
    """H rows, W columns, both at least 1.

    ranges: (H, W) uint16, steps of `step_m`, 0 = no return; intensity: (H, W) uint8; azimuth: (W,) uint16, 0.01 degree
    geometry: of the rows;  points: number of returns of the message, drawn or not
    """

    ranges: npt.NDArray[np.uint16]
    intensity: npt.NDArray[np.uint8]
    azimuth: npt.NDArray[np.uint16]
    geometry: RingGeometry
    step_m: float
    points: int

    @property
    def drawn(self) -> int:
        """Number of points in the image."""
        return int(np.count_nonzero(self.ranges))


class _Cells(NamedTuple):
    """Row and column of each point, (N,), and the directions of rows in radians and of columns in 0.01 degree."""

    row: Indices
    column: Indices
    elevation: Floats
    rotation: Floats
    azimuth: npt.NDArray[np.uint16]

    def off(self, points: Floats, ranges: Floats) -> Floats:
        """(N,) metres between points (3, N) and where they are drawn."""
        beta = np.radians(self.azimuth[self.column] * 0.01) - self.rotation[self.row]
        up = self.elevation[self.row]
        flat = ranges * np.cos(up)
        drawn = np.stack((flat * np.cos(beta), -flat * np.sin(beta), ranges * np.sin(up)))
        return np.asarray(np.sqrt(((drawn - points) ** 2).sum(axis=0)), np.float64)


_MADE: WeakKeyDictionary[Frame, CloudImage] = WeakKeyDictionary()


def cloud_image(frame: Frame) -> CloudImage:
    """The image of a frame of a point cloud. A message without points has one column without a return.

    Cost: 20 to 60 ms for 100,000 points, once for each frame.
    """
    found = _MADE.get(frame)
    if found is None:
        found = _MADE[frame] = _made(frame)
    return found


def still_holds(told: Mapping[str, Any], frame: Frame) -> bool:
    """Whether the rows of a cloud's image are drawn in their places with the event `sensor` that a viewer has."""
    image = cloud_image(frame)
    if told["rings"] != len(image.ranges) or told["range_step_m"] != image.step_m:
        return False
    filled = image.ranges.any(axis=1)
    off = [
        np.abs(np.asarray(told[name]) - getattr(image.geometry, name))[filled]
        for name in ("rot_correction_rad", "vert_correction_rad")
    ]
    return bool(max(one.max(initial=0.0) for one in off) <= SAME_RAD)


def _made(frame: Frame) -> CloudImage:
    message = read_message(payload_of(frame)) if frame.width else None
    if message is None or message.xyz is None or not 0 < message.head.points <= MAX_POINTS:
        return _empty(frame)
    ranges = np.sqrt((np.where(message.returns, message.xyz, 0.0) ** 2).sum(axis=0))
    chosen = np.flatnonzero(message.returns & (ranges <= FARTHEST_M))
    count = int(np.count_nonzero(message.returns))
    if not len(chosen):
        return _empty(frame)._replace(points=count)
    points, ranges = message.xyz[:, chosen], ranges[chosen]
    cells = _of_frame(frame, message, chosen, points, ranges)
    if cells is None:
        cells = _of_directions(points)
        close = cells.off(points, ranges) <= CLOSE_M + CLOSE * ranges
        chosen, ranges = chosen[close], ranges[close]
        cells = cells._replace(row=cells.row[close], column=cells.column[close])
    order = np.argsort(-ranges, kind="stable")  # of points in one cell the nearest stays
    cells = cells._replace(row=cells.row[order], column=cells.column[order])
    chosen, ranges = chosen[order], ranges[order]
    step_m = STEP_M
    while len(ranges) and ranges[0] > step_m * MAX_U16:
        step_m *= 2
    shape = len(cells.elevation), len(cells.azimuth)
    image, intensity = np.zeros(shape, np.uint16), np.zeros(shape, np.uint8)
    place = cells.row, cells.column
    image[place] = np.clip(np.rint(ranges / step_m), 1, MAX_U16)
    intensity[place] = np.minimum(intensity_of(message)[chosen], 255)
    none = np.zeros(shape[0])
    geometry = RingGeometry(cells.rotation, cells.elevation, none, none, none)
    return CloudImage(image, intensity, cells.azimuth, geometry, step_m, count)


def _empty(frame: Frame) -> CloudImage:
    rows = frame.sensor.rows
    nothing = np.zeros((rows, 1), np.uint16)
    geometry = RingGeometry(*(np.zeros(rows) for _ in RingGeometry._fields))
    return CloudImage(nothing, nothing.astype(np.uint8), np.zeros(1, np.uint16), geometry, STEP_M, 0)


def _of_frame(frame: Frame, message: CloudMessage, chosen: Indices, points: Floats, ranges: Floats) -> _Cells | None:
    """Rows and columns of the frame; None if a point would be drawn elsewhere, or they are not those of a whole turn,
    which viewers would put together of several frames."""
    rows, view = frame.sensor.rows, view_of(message, frame.sensor.rows)
    if view is None or not view.shown[chosen].all() or frame.width > _MOST_COLUMNS or not _is_turn(frame):
        return None
    row, column = view.row[chosen], view.column[chosen]
    azimuth: npt.NDArray[np.uint16] = frame.azimuth[0]
    turned = np.radians(azimuth[column] * 0.01) - np.arctan2(-points[1], points[0])
    count = np.maximum(np.bincount(row, minlength=rows), 1)
    rotation = np.arctan2(np.bincount(row, np.sin(turned), rows), np.bincount(row, np.cos(turned), rows))
    elevation = np.bincount(row, np.arctan2(points[2], np.hypot(points[0], points[1])), rows) / count
    cells = _Cells(row, column, elevation, rotation, azimuth)
    return cells if (cells.off(points, ranges) <= NEAR_M + NEAR * ranges).all() else None


def _is_turn(frame: Frame) -> bool:
    """Whether the columns of a frame are those of a whole turn."""
    azimuth = frame.azimuth[0].astype(np.int64)
    steps = np.abs((np.diff(azimuth) + AZIMUTH_TURN // 2) % AZIMUTH_TURN - AZIMUTH_TURN // 2)
    return len(steps) > 0 and float(np.mean(steps)) * frame.width >= _WHOLE_TURN * AZIMUTH_TURN


def _of_directions(points: Floats) -> _Cells:
    """Rows near to the directions of the points, and columns in even steps."""
    up = np.arctan2(points[2], np.hypot(points[0], points[1]))
    levels = _levels(up)
    row = len(levels) - 1 - np.searchsorted((levels[1:] + levels[:-1]) / 2, up)
    columns = COLUMNS[points.shape[1] > MANY]
    turned = np.degrees(np.arctan2(-points[1], points[0])) * 100.0
    column = np.rint(turned * columns / AZIMUTH_TURN).astype(np.intp) % columns
    azimuth = np.rint(np.arange(columns) * (AZIMUTH_TURN / columns)).astype(np.uint16)
    return _Cells(row, column, levels[::-1].copy(), np.zeros(len(levels)), azimuth)


def _levels(up: Floats) -> Floats:
    """At most `ROWS` elevations, rising: those of the lines that the points form, or, of points in no lines, half of
    them evenly, and half where most points are."""
    rising = np.sort(up)
    begins = np.concatenate(([0], np.flatnonzero(np.diff(rising) > _BETWEEN_LINES) + 1))
    ends = np.concatenate((begins[1:], [len(rising)])) - 1
    if len(begins) <= ROWS and (rising[ends] - rising[begins] <= _WIDEST_LINE).all():
        means = np.add.reduceat(rising, begins) / (ends - begins + 1)
        return np.asarray(means, np.float64)
    half = ROWS // 2
    even = np.linspace(rising[0], rising[-1], half)
    return np.unique(np.concatenate((even, np.quantile(rising, (np.arange(half) + 0.5) / half))))
