"""The images of a frame of another sensor than an HDL-64E, as the layout of its packets has them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from lidarcodec.errors import SectionError
from lidarcodec.packet_rest import PacketRest
from lidarcodec.sensors.images import Images, PacketLayout, Sensor, Unsigned
from lidarcodec.sensors.models.table import sensor_of
from lidarcodec.units import PACKET_BYTES

if TYPE_CHECKING:
    from lidarcodec.frame import Frame

RANGE: Final = "range"
INTENSITY: Final = "intensity"


def layout_of(frame: Frame) -> tuple[Sensor, PacketLayout] | None:
    """Sensor and layout of a frame's images; None of an HDL-64E, and if all of its packets are odd."""
    rest = frame.side
    if not isinstance(rest, PacketRest) or not rest.layout:
        return None
    family = sensor_of(frame.sensor)
    if family is None:
        return None
    layout = family.named_layout(rest.layout)
    if layout is None:
        raise SectionError(f"a layout '{rest.layout}' that sensor {frame.sensor.model} does not have")
    return family, layout


def images_of(frame: Frame, layout: PacketLayout) -> Images:
    """Planes and series of a frame, in the types of its layout; returns that are not kept are no returns."""
    given: dict[str, Unsigned] = {RANGE: frame.range, INTENSITY: frame.intensity, **frame.planes}
    rest = frame.side
    assert isinstance(rest, PacketRest)
    planes: dict[str, Unsigned] = {}
    for plane in layout.planes:
        values = given.get(plane.name)
        if values is None:
            values = np.zeros(frame.range.shape, plane.dtype)
        if frame.keep is not None:
            values = np.where(frame.keep, values, np.zeros((), values.dtype))
        planes[plane.name] = values.astype(plane.dtype, copy=False)
    return Images(planes, dict(rest.series))


def odd_count(frame: Frame) -> int:
    """Number of odd packets of a frame. The message of a point cloud is none."""
    return len(frame.side.odd) if isinstance(frame.side, PacketRest) and not frame.sensor.is_cloud else 0


def payload_bytes(frame: Frame) -> int:
    """Bytes of the data packets of a frame, of any sensor."""
    rest = frame.side
    if not isinstance(rest, PacketRest):
        return 0 if rest is None else rest.packets * PACKET_BYTES
    found = layout_of(frame)
    regular = 0 if found is None else found[1].packet_bytes * (rest.packets - len(rest.odd))
    return regular + sum(map(len, rest.odd_packets))
