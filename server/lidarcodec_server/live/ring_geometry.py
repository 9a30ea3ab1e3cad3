"""Geometry of a sensor other than an HDL-64E as a calibration of each ring, for viewers that compute points themselves.

The formula of docs/live-sockets.md (convention `veloview`) has a rotation correction, an elevation, a distance
correction and two offsets for each ring. It is fitted to the sensor's own formula: a cell's point is linear in the
range, so two ranges determine it. A sensor turns between the firings of a column; the mean of this angle over the
columns becomes part of the rotation correction. The rest, a few hundredths of a degree, is ignored.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import CalibrationError
from lidarcodec.frame import Frame
from lidarcodec.frame_images import images_of, layout_of
from lidarcodec.sensors.images import Images

COLUMNS: Final = 256
"""Number of columns used for the fit."""
MAX_U16: Final = 65_535
_FAR: Final = 4096
"""The second of the two ranges, in range steps."""

Values = npt.NDArray[np.float64]


class RingGeometry(NamedTuple):
    """For each ring, (H,): angles in radians, lengths in metres."""

    rot_correction_rad: Values
    vert_correction_rad: Values
    dist_correction_m: Values
    vert_offset_m: Values
    horiz_offset_m: Values


def ring_geometry(frame: Frame) -> RingGeometry | None:
    """The geometry of a frame's rings; None for a frame without points, such as one of an Ouster without metadata."""
    found = layout_of(frame)
    if found is None or not frame.width:
        return None
    family, layout = found
    images = images_of(frame, layout)
    shape = frame.range.shape
    try:
        near, far = (
            np.stack(family.points(frame.sensor, layout, _of_one_range(images, shape, steps))) for steps in (0, _FAR)
        )
    except CalibrationError:
        return None
    chosen = np.linspace(0, frame.width - 1, min(COLUMNS, frame.width)).astype(np.intp)
    origin = near[:, :, chosen]
    along = (far - near)[:, :, chosen] / (_FAR * frame.sensor.range_step_m)  # for each metre of range
    azimuth = np.radians(frame.azimuth[0, chosen] * 0.01)
    beta = np.arctan2(-along[1], along[0])
    rotation = np.angle(np.exp(1j * (azimuth - beta)).mean(axis=1))
    elevation = np.arctan2(along[2], np.hypot(along[0], along[1])).mean(axis=1)
    cos_b, sin_b = np.cos(beta), np.sin(beta)
    forward = (origin[0] * cos_b - origin[1] * sin_b).mean(axis=1)
    sideways = (origin[0] * sin_b + origin[1] * cos_b).mean(axis=1)
    distance = forward / np.cos(elevation)
    return RingGeometry(rotation, elevation, distance, origin[2].mean(axis=1) - distance * np.sin(elevation), sideways)


def shown_step(frame: Frame) -> int:
    """Number of the sensor's range steps in one step of a 16-bit range image."""
    if frame.sensor.is_hdl64e:
        return 1
    layout = layout_of(frame)
    bits = 16 if layout is None else layout[1].planes[0].bits
    return 1 << max(0, bits - 16)


def shown_ranges(frame: Frame) -> npt.NDArray[np.uint16]:
    """(H, W) uint16, the ranges in steps of `shown_step`. Returns stay returns, and empty cells stay empty."""
    if frame.sensor.is_hdl64e:
        return frame.range_u16 if frame.keep is None else np.where(frame.valid, frame.range_u16, np.uint16(0))
    step = shown_step(frame)
    ranges = np.where(frame.valid, frame.range, 0)
    return np.where(ranges > 0, np.clip((ranges + step // 2) // step, 1, MAX_U16), 0).astype(np.uint16)


def facts_of_rings(frame: Frame, geometry: RingGeometry | None, step_m: float) -> dict[str, Any]:
    """The lists of the event `sensor`, one value for each ring; zeros without a geometry.

    step_m: of the range image
    """
    rows = frame.sensor.rows if geometry is None else len(geometry.rot_correction_rad)
    values = RingGeometry(*(np.zeros(rows) for _ in RingGeometry._fields)) if geometry is None else geometry
    lists = {name: [round(float(value), 9) for value in getattr(values, name)] for name in RingGeometry._fields}
    distance = lists["dist_correction_m"]
    return {
        "range_step_m": step_m,
        "rings": rows,
        "laser": list(range(rows)) if frame.sensor.is_cloud else [int(laser) for laser in frame.sensor.laser_of_ring],
        "block": [0] * rows,
        **lists,
        "dist_correction_x_m": distance,
        "dist_correction_y_m": distance,
    }


def _of_one_range(images: Images, shape: tuple[int, ...], steps: int) -> Images:
    return Images({**images.planes, "range": np.full(shape, steps, images.planes["range"].dtype)}, images.series)
