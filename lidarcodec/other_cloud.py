"""Points of a frame of another sensor than an HDL-64E."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from lidarcodec.frame_images import images_of, layout_of
from lidarcodec.packet_rest import PacketRest
from lidarcodec.sensors.images import Images, PacketLayout, Sensor

if TYPE_CHECKING:
    from lidarcodec.frame import Frame

SECOND = "2"
"""End of the name of a plane of second returns."""


def other_cloud_of(frame: Frame, *, both: bool) -> npt.NDArray[np.void]:
    """(N,) structured array of the frame's returns: `x y z` f4, `intensity` u1 or u2, `laser` u1, `ring` u1, `t_ns` i8,
    a field for each further attribute, and `return_number` u1 where both returns are asked for.

    First returns come column by column, each column from the top ring down, then second ones in the same order; a
    second return that equals the first is left out. t_ns is the host time of the packet, plus the time between the
    packet's own stamp and the firing.
    """
    found = layout_of(frame)
    if found is None:
        return np.empty(0, _dtype_of(frame, [], both))
    family, layout = found
    images = images_of(frame, layout)
    first = frame.valid
    parts = [_points(frame, family, layout, images, first, 1, both)]
    if both and "range2" in images.planes:
        second = _second(images)
        parts.append(_points(frame, family, layout, images, second, 2, both))
    return np.concatenate(parts)


def second_returns_of(frame: Frame) -> int:
    """How many second returns `other_cloud_of` adds to the first ones."""
    found = layout_of(frame)
    if found is None or "range2" not in frame.planes:
        return 0
    return int(np.count_nonzero(_second(images_of(frame, found[1]))))


def _second(images: Images) -> npt.NDArray[np.bool_]:
    """(H, W) bool, where there is a second return that is not the first one sent again."""
    second: npt.NDArray[np.bool_] = (images.planes["range2"] > 0) & ~_same(images)
    return second


def _same(images: Images) -> npt.NDArray[np.bool_]:
    """(H, W) bool, where the second return is the first one sent again."""
    same: npt.NDArray[np.bool_] = images.planes["range2"] == images.planes["range"]
    if "intensity2" in images.planes:
        same &= images.planes["intensity2"] == images.planes["intensity"]
    return same


def _attributes(layout: PacketLayout) -> list[str]:
    """Names of the attributes of first returns, without the intensity."""
    return [
        plane.name
        for plane in layout.planes
        if plane.role == "attribute" and plane.name != "intensity" and not plane.name.endswith(SECOND)
    ]


def _dtype_of(frame: Frame, attributes: list[str], both: bool) -> np.dtype[np.void]:
    fields: list[tuple[str, npt.DTypeLike]] = [("x", "f4"), ("y", "f4"), ("z", "f4")]
    fields += [("intensity", frame.intensity.dtype), ("laser", "u1"), ("ring", "u1"), ("t_ns", "i8")]
    fields += [(name, frame.planes[name].dtype) for name in attributes if name in frame.planes]
    return np.dtype(fields + ([("return_number", "u1")] if both else []))


def _points(
    frame: Frame,
    family: Sensor,
    layout: PacketLayout,
    images: Images,
    chosen: npt.NDArray[np.bool_],
    number: int,
    both: bool,
) -> npt.NDArray[np.void]:
    end = SECOND if number == 2 else ""
    attributes = _attributes(layout)
    cells = np.flatnonzero(chosen.T)
    column, ring = np.divmod(cells, frame.sensor.rows)
    points = np.empty(len(cells), _dtype_of(frame, attributes, both))
    for name, values in zip("xyz", family.points(frame.sensor, layout, images, f"range{end}"), strict=True):
        points[name] = values[ring, column]
    planes = {"intensity": frame.intensity, **frame.planes}
    for name in ("intensity", *attributes):
        if name in planes:
            points[name] = planes.get(f"{name}{end}", planes[name])[ring, column]
    points["ring"] = ring
    points["laser"] = frame.sensor.laser_of_ring[ring]
    points["t_ns"] = frame.stamp_ns + _times_ns(frame, family, layout, images, ring, column)
    if both:
        points["return_number"] = number
    return points


def _times_ns(
    frame: Frame,
    family: Sensor,
    layout: PacketLayout,
    images: Images,
    ring: npt.NDArray[np.intp],
    column: npt.NDArray[np.intp],
) -> npt.NDArray[np.int64]:
    rest = frame.side
    assert isinstance(rest, PacketRest)
    times = family.times_ns(layout, images)
    within: npt.NDArray[np.int64] = times[ring if len(times) > 1 else 0, column if times.shape[1] > 1 else 0]
    return rest.packet_ns[rest.regular][column // layout.columns] + within
