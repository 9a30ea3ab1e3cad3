"""Small frames of any sensor beside the HDL-64E, made of numbers: of models and modes that no capture has, and small
enough to be kept as test vectors.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from lidarcodec.frame import Frame
from lidarcodec.packet import Packet
from lidarcodec.pipeline import frames_of
from lidarcodec.sensor_model import SensorModel
from lidarcodec.sensors.images import Images, PacketLayout, Unsigned
from lidarcodec.sensors.models.blocks import BlockLayout
from lidarcodec.sensors.models.ouster.fields import PIXELS
from lidarcodec.sensors.models.ouster.layouts import OusterLayout
from lidarcodec.sensors.models.ouster.sensor import model_from, sensor_from
from lidarcodec.sensors.models.table import block_sensors, sensor_named, sensor_of
from tests.sensors.ouster_packets import as_json, flat_metadata

HOST_NS = 1_700_000_000_000_000_000
LEGACY_STATUS = 0xFFFF_FFFF


def block_sensor(model: str) -> SensorModel:
    """A Velodyne or Hesai with its nominal calibration, and offsets that are not 0."""
    return sensor_named(model).generic_sensor


def ouster(profile: str, rows: int, product: str) -> SensorModel:
    """An Ouster with metadata."""
    return model_from(as_json(flat_metadata(profile, rows, product)), "given")


def _plane(name: str, bits: int, shape: tuple[int, int], seed: int) -> Unsigned:
    """A wall with an edge, holes and some noise; attributes are shades of it."""
    rng = np.random.default_rng([seed, len(name), ord(name[-1])])
    row, column = np.indices(shape)
    values = 900 + 14 * row + 3 * ((column + 5 * seed) % 60) + 700 * (column % 40 > 24)
    if name.endswith("2"):
        values = values + 60 * (column % 3 == 0)
    values = (
        np.where(np.random.default_rng(seed).random(shape) < 0.15, 0, values)
        if name.startswith("range")
        else values // 7
    )
    return (values + (values > 0) * rng.integers(0, 2, shape)).clip(0, (1 << bits) - 1).astype(np.uint32)


def _series(layout: PacketLayout, packets: int, first: int) -> dict[str, Unsigned]:
    """Series as a sensor that turns sends them. first: number of the first packet"""
    found: dict[str, Unsigned] = {}
    for name, (dtype, each) in layout.series.items():
        at = np.arange(packets * each) + first * each
        values = np.full(packets * each, 1)
        if name == "azimuth":
            values = (35_000 + at * 39) % 36_000
        elif name == "azimuth_rest":
            values = np.zeros(packets * each, np.int64)
        elif name in ("time_us", "udp_sequence"):
            values = 3_000_000 + 1327 * at
        elif name == "time_ns":
            values = 5_000_000_000 + 97_650 * at
        elif name == "measurement_id":
            values = (500 + at) % 1024
        elif name == "encoder":
            values = (500 + at) % 1024 * 88
        elif name == "status" and isinstance(layout, OusterLayout) and layout.legacy:
            values = np.full(packets * each, LEGACY_STATUS)
        elif isinstance(layout, BlockLayout) and name in layout.modes:
            values = np.full(packets * each, layout.modes[name][0])
        found[name] = values.astype(dtype)
    return found


def packets_of_model(sensor: SensorModel, layout_name: str, count: int, seed: int = 0) -> list[Packet]:
    """So many packets, one after the other in time."""
    family = sensor_of(sensor)
    assert family is not None
    layout = family.named_layout(layout_name)
    assert layout is not None, layout_name
    shape = (layout.rows, count * layout.columns)
    planes: Mapping[str, Unsigned] = {
        plane.name: _plane(plane.name, plane.bits, shape, seed).astype(plane.dtype) for plane in layout.planes
    }
    payloads = layout.join(Images(dict(planes), _series(layout, count, 10 * seed)))
    return [
        Packet(payload.tobytes(), HOST_NS + 1_327_000 * (10 * seed + place)) for place, payload in enumerate(payloads)
    ]


def made_frames(sensor: SensorModel, layout: str, packets: int, count: int) -> list[Frame]:
    """So many frames of so many packets each, and an odd packet in every third."""
    frames = []
    for number in range(count):
        sent = packets_of_model(sensor, layout, packets, number)
        if number % 3 == 2:
            sent.insert(1, Packet(b"\1" * len(sent[0].payload), sent[0].stamp_ns + 1000))
        (frame,) = frames_of(sent, sensor, f"packets:{len(sent)}")
        frames.append(frame.with_(index=number))
    return frames


def made_layouts() -> list[tuple[SensorModel, str]]:
    """Each layout of each model: of Ousters those of 16 and 128 beams, with each profile."""
    found = [(sensor.generic_sensor, layout.name) for sensor in block_sensors() for layout in sensor.layouts]
    for profile in PIXELS:
        for rows in (16, 128):
            sensor = ouster(profile, rows, f"OS-0-{rows}")
            found.append((sensor, sensor_from(sensor.description).layout.name))
    return found
