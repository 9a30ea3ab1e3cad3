"""Damaged packets of every model, metadata of Ousters, point clouds, and bags of ROS 1 and ROS 2 with clouds."""

from __future__ import annotations

import io
import random
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from lidarcodec.errors import SectionError
from lidarcodec.image_frame import cloud_frame
from lidarcodec.planes.clouds.section import decode_cloud, encode_cloud
from lidarcodec.planes.plane_section import PlaneKind
from lidarcodec.recording import RosbagWriter
from lidarcodec.sensor_model import SensorModel
from lidarcodec.sensors.clouds.grid import grid_of
from lidarcodec.sensors.clouds.message import ROS1, read_message
from lidarcodec.sensors.clouds.points import cloud_points
from lidarcodec.sensors.clouds.sensor import cloud_evidence, cloud_sensor
from lidarcodec.sensors.images import PacketLayout, Sensor
from lidarcodec.sensors.models.ouster.sensor import bare_sensor_of, model_from, sensor_from
from lidarcodec.sensors.models.table import sensor_of
from tests.fuzz.inside_others import damaged_cloud, damaged_json
from tests.fuzz.mutations import mutated, wounded
from tests.fuzz.other_sensors import cloud_messages
from tests.packets import packets_in
from tests.sensors.made_frames import PIXELS, made_layouts, packets_of_model
from tests.sensors.ouster_packets import as_json, flat_metadata, nested_metadata
from tests.sources.test_cloud_bags import bag1 as made_bag

Case = tuple[bytes, Callable[[bytes], object]]
Target = Callable[[random.Random], Case]


def sensor_targets() -> dict[str, Target]:
    """What is fuzzed here, by name."""
    return {
        "packets of other sensors": packet_target(),
        "metadata": metadata_target(),
        "cloud messages": cloud_target(),
        "cloud sections": section_target(),
        "bags with clouds": bag_target(),
    }


def packet_target() -> Target:
    """Damaged packets of a layout, split and joined: what fits comes back exactly, odd ones by their own rule."""
    kinds: list[tuple[Sensor, PacketLayout, bytes]] = []
    for sensor, name in made_layouts():
        family = sensor_of(sensor)
        layout = None if family is None else family.named_layout(name)
        assert family is not None
        assert layout is not None
        kinds += [(family, layout, packet.payload) for packet in packets_of_model(sensor, name, 2)]

    def case(rng: random.Random) -> Case:
        family, layout, clean = rng.choice(kinds)
        hurt = mutated if rng.random() < 0.5 else wounded
        data = hurt(clean, rng)
        if rng.random() < 0.9:
            data = data[: len(clean)].ljust(len(clean), b"\0")

        def read(damaged: bytes) -> None:
            found = family.layout_of(damaged)
            family.evidence(damaged)
            bare_sensor_of(damaged)
            if len(damaged) != layout.packet_bytes:
                raise SectionError("a packet of another size")
            packets = np.frombuffer(damaged, np.uint8)[None]
            if not layout.fits(packets)[0]:
                raise SectionError("a packet that does not fit its layout")
            images = layout.split(packets)
            again = layout.split(layout.join(images))
            for name, plane in images.planes.items():
                assert np.array_equal(again.planes[name], plane), name
            assert (family.azimuth(layout, images) < 36_000).all()
            family.times_ns(layout, images)
            assert found is None or found.packet_bytes == layout.packet_bytes

        return data, read

    return case


def metadata_target() -> Target:
    """Metadata with values that are others, missing or of another kind; and its bytes damaged."""
    flat = [flat_metadata(profile, rows, f"OS-0-{rows}") for profile in PIXELS for rows in (16, 32)]
    whole = [as_json(tree) for one in flat for tree in (one, nested_metadata(one))]

    def read(damaged: bytes) -> None:
        sensor = model_from(damaged, "given")
        assert sensor_from(damaged).layout.rows == sensor.rows

    def case(rng: random.Random) -> Case:
        return damaged_json(rng.choice(whole), rng), read

    return case


def cloud_target() -> Target:
    """Damaged PointCloud2 messages: frame and points of each, and each there and back exactly."""
    messages = cloud_messages(1)
    kinds = (PlaneKind.ZSTD, PlaneKind.QUICK)

    def case(rng: random.Random) -> Case:
        data = rng.choice(messages)
        data = (mutated if rng.random() < 0.5 else wounded)(data, rng)
        coded = rng.random() < 0.2
        kind = rng.choice(kinds)

        def read(damaged: bytes) -> None:
            cloud_evidence(damaged)
            frame = cloud_frame(0, 0, damaged, cloud_sensor([damaged]))
            cloud_points(frame, both=True)
            if coded and decode_cloud(encode_cloud(damaged, kind)).payload != damaged:
                raise AssertionError("a message did not come back")
            read_message(damaged)

        return data, read

    return case


def section_target() -> Target:
    """Damaged CLOUD sections, and the frames of what they hold."""
    ways = [(kind, bound) for kind in PlaneKind if kind != PlaneKind.FOLLOWING for bound in (None, 0.05)]
    clean = [
        (encode_cloud(data, kind, bound), cloud_sensor([data])) for data in cloud_messages(2) for kind, bound in ways
    ]

    def case(rng: random.Random) -> Case:
        data, sensor = rng.choice(clean)
        return damaged_cloud(data, rng), lambda damaged: _frame_of(damaged, sensor)

    return case


def _frame_of(section: bytes, sensor: SensorModel) -> None:
    cloud = decode_cloud(section)
    frame = cloud_frame(0, 0, cloud.payload, sensor, find=grid_of if cloud.grid is None else lambda _: cloud.grid)
    cloud_points(frame, both=False)


def bag_target() -> Target:
    """Damaged and cut bags of ROS 1, plain and compressed, and of ROS 2, with clouds."""
    folder = tempfile.TemporaryDirectory(prefix="lidarcodec-fuzz-")
    place, messages = Path(folder.name), cloud_messages(3)
    old = [one[len(ROS1) :] for one in messages if one[: len(ROS1)] == ROS1]
    forms = {".bag": [made_bag(place / "clean.bag", old[:2], name).read_bytes() for name in (b"none", b"bz2", b"lz4")]}
    buffer = io.BytesIO()
    with RosbagWriter(buffer, points_topic="/points") as writer:
        for number, one in enumerate(messages[:2]):
            writer.write_message(number, one)
    forms[".mcap"] = [buffer.getvalue()]

    def case(rng: random.Random) -> Case:
        suffix = rng.choice(list(forms))
        clean = rng.choice(forms[suffix])
        data = clean[: rng.randrange(len(clean))] if rng.random() < 0.2 else mutated(clean, rng)

        def read(damaged: bytes) -> None:
            path = Path(folder.name) / f"damaged{suffix}"
            path.write_bytes(damaged)
            packets_in(path)

        return data, read

    return case
