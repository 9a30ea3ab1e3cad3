"""Small frames of every sensor beside the HDL-64E, and small point clouds, each extreme in its own way.

Each function gives the frames of a short stream. The same seed gives the same frames.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import SectionError
from lidarcodec.frame import Frame
from lidarcodec.packet import Packet
from lidarcodec.packet_rest import PacketRest
from lidarcodec.pipeline import frames_of
from lidarcodec.sensor_model import SensorModel
from lidarcodec.sensors.clouds.sensor import cloud_sensor
from lidarcodec.sensors.images import Bytes, Images, PacketLayout
from lidarcodec.sensors.models.ouster.sensor import sensor_from
from lidarcodec.sensors.models.table import sensor_of
from lidarcodec.side import Position
from tests.contracts import frames
from tests.point_clouds import message, nebula, ouster, plain, ros1, velodyne
from tests.sensors import made_frames as made

HOST_NS = made.HOST_NS
_WIDER: Sequence[tuple[str, str]] = (("double", "<f8"), ("many", "<u2"), ("big", "<i4"), ("small", "i1"))


def of_model(model: str, seed: int) -> list[Frame]:
    """Frames of a Velodyne or Hesai, in each layout of its packets. Their numbers rise: they are one stream."""
    sensor = made.block_sensor(model)
    family = sensor_of(sensor)
    assert family is not None
    layouts = [layout for one, layout in made.made_layouts() if one.model == model]
    return _numbered([frame for layout in layouts for frame in _of_layout(sensor, layout, seed)])


def of_ouster(rows: int, seed: int) -> list[Frame]:
    """The same of an Ouster, with each profile of its packets."""
    sensors = [made.ouster(profile, rows, f"OS-0-{rows}") for profile in made.PIXELS]
    layouts = [sensor_from(sensor.description).layout.name for sensor in sensors]
    found = zip(sensors, layouts, strict=True)
    return _numbered([frame for sensor, layout in found for frame in _of_layout(sensor, layout, seed)])


def _numbered(found: Sequence[Frame]) -> list[Frame]:
    return [frame.with_(index=index) for index, frame in enumerate(found)]


def _of_layout(sensor: SensorModel, name: str, seed: int) -> Iterator[Frame]:
    """Frames that follow each other as a sensor sends them, and such as it never sends."""
    family = sensor_of(sensor)
    layout = None if family is None else family.named_layout(name)
    assert layout is not None
    likely = made.made_frames(sensor, name, 1, 4)  # the third has an odd packet
    yield from likely
    for number, payloads in enumerate(_extremes(layout, sensor, np.random.default_rng(seed))):
        packets = [Packet(one.tobytes(), HOST_NS + 10**6 * (number + place)) for place, one in enumerate(payloads)]
        (frame,) = frames_of(packets, sensor, f"packets:{len(packets)}")
        yield frame
    last = np.iinfo(np.int64).max
    yield likely[0].with_(pose=frames.pose(seed), stamp_ns=last)
    rest = likely[1].side
    assert isinstance(rest, PacketRest)
    sent = (Position(0, 5, b"\1" * 48), Position(1, 2000, b""), Position(1, 2000, bytes(48)))
    yield likely[1].with_(side=rest.with_positions(sent), stamp_ns=-last)


def _extremes(layout: PacketLayout, sensor: SensorModel, rng: np.random.Generator) -> Iterator[Bytes]:
    """(P, packet_bytes) payloads: no returns, all of them at the least and the most, noise, numbers at their limits."""
    payloads = [one.payload for one in made.packets_of_model(sensor, layout.name, 2)]
    given = layout.split(np.frombuffer(b"".join(payloads), np.uint8).reshape(2, -1))
    shape, most = given.planes["range"].shape, {plane.name: (1 << plane.bits) - 1 for plane in layout.planes}
    even = np.add.outer(np.arange(shape[0]), np.arange(shape[1])) % 2
    fills: tuple[Callable[[int], npt.NDArray[np.int64]], ...] = (
        lambda top: np.zeros(shape, np.int64),
        lambda top: np.full(shape, top),
        lambda top: np.ones(shape, np.int64),
        lambda top: rng.integers(0, top + 1, shape),
        lambda top: even * top,
        lambda top: (rng.random(shape) < 0.03) * rng.integers(0, top + 1, shape),
    )
    for fill in fills:
        planes = {name: fill(top).astype(given.planes[name].dtype) for name, top in most.items()}
        yield from _joined(layout, replace(given, planes=planes))
    for series in (
        {name: np.full_like(values, np.iinfo(values.dtype).max) for name, values in given.series.items()},
        {name: np.zeros_like(values) for name, values in given.series.items()},
        {name: rng.integers(0, 256, values.shape).astype(values.dtype) for name, values in given.series.items()},
    ):
        yield from _joined(layout, replace(given, series=series))
    yield rng.integers(0, 256, (2, layout.packet_bytes), np.uint8)  # odd ones


def _joined(layout: PacketLayout, images: Images) -> Iterator[Bytes]:
    """The payloads, if these numbers fit into packets."""
    try:
        yield layout.join(images)
    except SectionError:
        return


def clouds(seed: int) -> list[Frame]:
    """Point clouds: as drivers send them and as none does, each with a sensor of its own."""
    return _numbered(
        [
            frame
            for data in cloud_messages(seed)
            for frame in frames_of([Packet(data, HOST_NS)], cloud_sensor([data]), "packets:1")
        ]
    )


def cloud_messages(seed: int) -> list[bytes]:
    """Small PointCloud2 messages of ROS 2 and ROS 1."""
    turn, organised = velodyne(12, 8, seed), ouster(8, 16)
    lost, far, still = turn.copy(), turn.copy(), turn.copy()
    for axis in "xyz":
        lost[axis], far[axis], still[axis] = np.nan, 3e38, 0
    double = np.zeros(30, [(axis, "<f8") for axis in "xyz"])
    double["x"], double["z"] = np.arange(30) * 1e-3, 1e300
    found = [
        message(turn),
        message(organised, 16),
        message(ouster(8, 16, nan=True), 16, padding=b"\5" * 7, tail=b"behind"),
        message(velodyne(12, 8, seed + 1), dense=0),
        message(turn.astype(turn.dtype.newbyteorder(">")), big_endian=True),
        message(plain(40, _WIDER, seed)),
        message(plain(24, [("more", "<f4", (5,))], seed), counts={"more": 5}),
        message(turn[:0]),
        message(turn[:1]),
        message(lost),
        message(far),
        message(still),
        message(double),
        message(plain(40, seed=seed), 8),
        message(nebula(12, 8)),
    ]
    return found + [ros1(data) for data in (found[0], found[1], found[7])]


MODELS = tuple(dict.fromkeys(sensor.model for sensor, _ in made.made_layouts() if not sensor.model.startswith("os")))
SIZES: dict[str, Callable[[int], list[Frame]]] = {
    **{model: partial(of_model, model) for model in MODELS},
    "os0-16": partial(of_ouster, 16),
    "os0-128": partial(of_ouster, 128),
    "clouds": clouds,
}
"""How to make the frames of a stream, by the model of its sensor."""
