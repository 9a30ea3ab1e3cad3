"""Makes a frame of the planes of another sensor than an HDL-64E, and the rest of its packets."""

from __future__ import annotations

import numpy as np

from lidarcodec.errors import SectionError
from lidarcodec.frame import Frame
from lidarcodec.frame_images import INTENSITY, RANGE
from lidarcodec.packet_rest import PacketRest
from lidarcodec.sensor_model import SensorModel
from lidarcodec.sensors.images import Images, Unsigned, check_series
from lidarcodec.sensors.models.table import sensor_of


def image_frame(index: int, stamp_ns: int, planes: dict[str, Unsigned], rest: PacketRest, sensor: SensorModel) -> Frame:
    """The frame of these planes and the rest of its packets. Planes that are missing are empty or 0.

    Raises SectionError if planes, series and layout do not fit together.
    """
    family = sensor_of(sensor)
    layout = None if family is None or not rest.layout else family.named_layout(rest.layout)
    if rest.layout and layout is None:
        raise SectionError(f"a layout '{rest.layout}' that sensor {sensor.model} does not have")
    ranges = planes.pop(RANGE, np.zeros((sensor.rows, 0), np.uint32)).astype(np.uint32)
    intensity = planes.pop(INTENSITY, np.zeros(ranges.shape, np.uint8))
    if family is None or layout is None:
        azimuth = np.zeros(ranges.shape[1], np.uint16)
    else:
        packets = len(rest.regular)
        if ranges.shape != (layout.rows, packets * layout.columns):
            raise SectionError(f"planes {ranges.shape} of {packets} packets of {layout.rows} x {layout.columns}")
        check_series(layout, rest.series, packets)
        azimuth = family.azimuth(layout, Images({RANGE: ranges}, dict(rest.series)))
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
