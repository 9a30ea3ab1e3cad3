"""Makes frames of other sensors than an HDL-64E: of planes and the rest of their packets, or of a point cloud.

A frame of a point cloud is one `sensor_msgs/PointCloud2` message, and its images are a view of it. The message is the
frame's only packet, and travels as one (`PacketRest.odd_packets`). Range, intensity and azimuth are made from its
points, for viewers and measures; nothing is computed back from them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import DecodeError, SectionError
from lidarcodec.frame import Frame
from lidarcodec.frame_images import INTENSITY, RANGE
from lidarcodec.packet_rest import PacketRest
from lidarcodec.sensor_model import SensorModel
from lidarcodec.sensors.clouds.grid import Grid, grid_of
from lidarcodec.sensors.clouds.message import CloudMessage, read_message
from lidarcodec.sensors.clouds.values import intensity_of
from lidarcodec.sensors.clouds.view import View, view_of
from lidarcodec.sensors.images import Images, Unsigned, check_series
from lidarcodec.sensors.models.table import sensor_of
from lidarcodec.side import Position
from lidarcodec.units import AZIMUTH_TURN

MOST_STEPS: Final = (1 << 20) - 1


def image_frame(index: int, stamp_ns: int, planes: dict[str, Unsigned], rest: PacketRest, sensor: SensorModel) -> Frame:
    """The frame of these planes and the rest of its packets. Planes that are missing are empty or 0.

    Raises SectionError if planes, series and layout do not fit together.
    """
    family = sensor_of(sensor)
    layout = None if family is None or not rest.layout else family.named_layout(rest.layout)
    if rest.layout and layout is None:
        raise SectionError(f"a layout '{rest.layout}' that sensor {sensor.model} does not have")
    ranges = planes.get(RANGE, np.zeros((sensor.rows, 0), np.uint32))
    if family is None or layout is None:
        azimuth = np.zeros(ranges.shape[1], np.uint16)
    else:
        packets = len(rest.regular)
        if ranges.shape != (layout.rows, packets * layout.columns):
            raise SectionError(f"planes {ranges.shape} of {packets} packets of {layout.rows} x {layout.columns}")
        check_series(layout, rest.series, packets)
        # A message may say a narrower type for its numbers, in which sums of them would not fit.
        typed = {name: rest.series[name].astype(dtype, copy=False) for name, (dtype, _) in layout.series.items()}
        rest = replace(rest, series=typed)
        azimuth = family.azimuth(layout, Images({RANGE: ranges}, dict(rest.series)))
    return frame_of_planes(index, stamp_ns, planes, azimuth, rest, sensor)


def frame_of_planes(
    index: int,
    stamp_ns: int,
    planes: dict[str, Unsigned],
    azimuth: npt.NDArray[np.uint16],
    rest: PacketRest,
    sensor: SensorModel,
) -> Frame:
    """The frame of planes that fit its sensor and layout. azimuth: (W,); planes that are missing are empty or 0."""
    ranges = planes.pop(RANGE, np.zeros((sensor.rows, 0), np.uint32)).astype(np.uint32, copy=False)
    intensity = planes.pop(INTENSITY, np.zeros(ranges.shape, np.uint8))
    return Frame(
        index,
        stamp_ns,
        ranges,
        intensity,
        np.stack((azimuth, azimuth)),
        np.ones((2, ranges.shape[1]), np.bool_),
        sensor,
        rest,
        planes=planes,
    )


def cloud_frame(
    index: int,
    stamp_ns: int,
    payload: bytes,
    sensor: SensorModel,
    positions: tuple[Position, ...] = (),
    find: Callable[[CloudMessage], Grid | None] = grid_of,
) -> Frame:
    """The frame of a message. What is no PointCloud2, or has no x, y and z, has images without columns.

    find: gives the range image of its points
    """
    rest = PacketRest("", np.zeros(1, np.int64), np.zeros(1, np.uint16), (payload,), {}, positions)
    try:
        message: CloudMessage | None = read_message(payload)
    except DecodeError:
        message = None
    view = None if message is None else view_of(message, sensor.rows, find)
    if message is None or view is None:
        nothing = np.zeros((sensor.rows, 0), np.uint32)
        azimuth = np.zeros(0, np.uint16)
        intensity = np.zeros((sensor.rows, 0), np.uint8)
        return _frame(index, stamp_ns, nothing, intensity, azimuth, sensor, rest)
    ranges = view.image(_ranges(message, sensor.range_step_m), np.uint32)
    levels = intensity_of(message)
    intensity = view.image(levels, levels.dtype)
    return _frame(index, stamp_ns, ranges, intensity, column_azimuths(message, view), sensor, rest)


def _frame(
    index: int,
    stamp_ns: int,
    ranges: npt.NDArray[np.uint32],
    intensity: npt.NDArray[Any],
    azimuth: npt.NDArray[np.uint16],
    sensor: SensorModel,
    rest: PacketRest,
) -> Frame:
    fired = np.ones((2, len(azimuth)), np.bool_)
    return Frame(index, stamp_ns, ranges, intensity, np.stack((azimuth, azimuth)), fired, sensor, rest)


def _ranges(message: CloudMessage, step_m: float) -> npt.NDArray[np.uint32]:
    """(N,) distance of each point from the origin, in steps; 0 without a return, else at least 1."""
    with np.errstate(invalid="ignore", over="ignore"):
        squares = [axis * axis for axis in _axes(message)]
        steps = np.rint(np.sqrt(squares[0] + squares[1] + squares[2]) / step_m)
    steps = np.clip(np.where(message.returns, steps, 1), 1, MOST_STEPS)
    return np.where(message.returns, steps, 0).astype(np.uint32)


def _axes(message: CloudMessage) -> list[npt.NDArray[np.float64]]:
    """x, y and z of the points, (N,) each."""
    with np.errstate(invalid="ignore"):  # signalling NaN
        return [np.asarray(message.values(name), np.float64) for name in "xyz"]


def column_azimuths(message: CloudMessage, view: View) -> npt.NDArray[np.uint16]:
    """(W,) mean direction of the points of each column, 0.01 degree, clockwise seen from above; 0 is along x."""
    shown = view.shown & message.returns
    x, y, _ = (axis[shown] for axis in _axes(message))
    column = view.column[shown]
    far = np.maximum(np.sqrt(x * x + y * y), 1e-9)
    cosine, sine = (np.bincount(column, axis / far, view.columns) for axis in (x, y))
    steps = np.rint(np.degrees(np.arctan2(-sine, cosine)) * 100).astype(np.int64) % AZIMUTH_TURN
    last = np.maximum.accumulate(np.where((cosine != 0) | (sine != 0), np.arange(view.columns), 0))
    found: npt.NDArray[np.uint16] = steps[last].astype(np.uint16)
    return found
