"""Point clouds by the C library: what a vehicle's C++ program loses if these fail are its driver's very messages."""

from __future__ import annotations

import json
import random
import struct
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lidarcodec import wire
from lidarcodec.errors import DecodeError
from lidarcodec.frame import Frame
from lidarcodec.image_frame import cloud_frame
from lidarcodec.message import SectionType
from lidarcodec.pipeline import StreamDecoder, StreamEncoder
from lidarcodec.sensors.clouds.message import read_message, values_at
from lidarcodec.sensors.clouds.points import payload_of
from lidarcodec.sensors.clouds.sensor import cloud_sensor
from lidarcodec.settings import settings_from
from tests.clients.c_session import CSession, Decoded
from tests.planes.cloud_messages import CLOUDS, other_order, several
from tests.point_clouds import message as made
from tests.point_clouds import ouster, velodyne
from tests.vectors import cloud_vectors
from tests.vectors.make import split

VECTORS = sorted(cloud_vectors.FOLDER.glob("*.bin"))
CODECS = ("raw", "zstd", "pcodec", "riddle", "predictive")
ORDERED = ("velodyne", "ouster", "nebula", "nan", "other order", "without rings")
"""With images of all kinds: these are sent by all codecs, the others by two."""
SMALL = {
    "velodyne": made(velodyne(30)),
    "ouster": made(ouster(32), 16),
    "several": several(),
    "other order": other_order(),
}
STREAMS = [(codec, name) for codec in CODECS for name in CLOUDS if codec in ("raw", "zstd") or name in ORDERED]


@pytest.fixture
def session(bare: CSession) -> CSession:
    return bare


def sent(codec: str, payload: bytes, **more: object) -> tuple[Frame, bytes]:
    """A frame as the package decodes it, and its message."""
    frame = cloud_frame(3, 10**18, payload, cloud_sensor([payload]))
    (message,) = StreamEncoder(settings_from({"codec": codec, **more}), 7).encode(frame)
    (decoded,) = StreamDecoder().decode(message)
    return decoded, wire.pack(message)


def alike(frame: Frame, found: Decoded, session: CSession) -> None:
    payload = payload_of(frame)
    assert (found.model, found.sensor, found.stamp_ns) == ("pointcloud2", frame.sensor.name, frame.stamp_ns)
    assert session.message() == payload
    cloud = frame.cloud("first")
    assert len(found.points) == len(found.all_points) == len(cloud)
    for name in ("x", "y", "z", "intensity", "laser", "ring", "t_ns"):
        np.testing.assert_array_equal(found.points[name], cloud[name], name)
    assert (found.points["return_number"] == 1).all()
    try:
        message = read_message(payload)
    except DecodeError:
        assert session.fields() == []
        return
    fields = session.fields()
    assert [name for name, _ in fields] == [one.name for one in message.head.fields]
    for (_, values), one in zip(fields, message.head.fields, strict=True):
        dtype = message.head.dtype_of(one)
        for number in range(one.repeated):
            wanted = values_at(message.points, one.offset + number * dtype.itemsize, dtype)
            assert wanted.tobytes() == np.ascontiguousarray(values[:, number]).tobytes()
    if len(cloud):
        (x,) = (values for name, values in fields if name == "x")
        np.testing.assert_array_equal(x[found.points["cell"], 0].astype(np.float32), cloud["x"])


@pytest.mark.parametrize(("codec", "name"), STREAMS, ids=[" ".join(one) for one in STREAMS])
def test_a_cloud_is_that_of_the_package_bit_for_bit(codec: str, name: str, session: CSession) -> None:
    frame, data = sent(codec, CLOUDS[name])
    assert payload_of(frame) == CLOUDS[name]
    alike(frame, session.push(data), session)


@pytest.mark.parametrize("codec", ["zstd", "pcodec", "riddle", "predictive"])
@pytest.mark.parametrize("name", ["velodyne", "ouster"])
def test_points_with_a_bound_are_those_of_the_package(codec: str, name: str, session: CSession) -> None:
    frame, data = sent(codec, CLOUDS[name], max_error_m=0.01)
    assert payload_of(frame) != CLOUDS[name]
    alike(frame, session.push(data), session)


@pytest.mark.parametrize("path", VECTORS, ids=lambda path: path.stem)
def test_the_vectors_that_all_decoders_share(path: Path, session: CSession) -> None:
    decoder = StreamDecoder()
    for data, wanted in zip(split(path.read_bytes()), json.loads(path.with_suffix(".json").read_text()), strict=True):
        (frame,) = decoder.decode(wire.unpack(data))
        assert {"stream": str(cloud_vectors.STREAM), **wanted} == cloud_vectors.expected_of_cloud(frame)
        alike(frame, session.push(data), session)


def test_damaged_clouds_end_as_in_the_package(session: CSession) -> None:
    """Sections with right checksums and any bits changed, or cut: the same points, or errors of the same class."""
    rng = random.Random(8)
    outcomes = set()
    for codec, name in (("zstd", "velodyne"), ("zstd", "several"), ("predictive", "ouster"), ("pcodec", "other order")):
        frame = cloud_frame(0, 10**18, SMALL[name], cloud_sensor([SMALL[name]]))
        (message,) = StreamEncoder(settings_from({"codec": codec}), 7).encode(frame)
        at = next(i for i, one in enumerate(message.sections) if one.type == SectionType.CLOUD)
        for number in range(60):
            section = bytearray(message.sections[at].data)
            place = rng.randrange(len(section))
            if number % 4:
                section[place] ^= 1 << rng.randrange(8)
            else:
                del section[place:]
            parts = list(message.sections)
            parts[at] = parts[at]._replace(data=bytes(section))
            changed = replace(message, sections=tuple(parts))
            try:
                (decoded,) = StreamDecoder().decode(changed)
            except DecodeError as error:
                with pytest.raises(type(error)):
                    session.push(wire.pack(changed))
                outcomes.add(type(error).__name__)
            else:
                alike(decoded, session.push(wire.pack(changed)), session)
                outcomes.add("decoded")
    assert outcomes >= {"SectionError", "decoded"}


def test_fields_and_messages_are_those_of_clouds_alone(session: CSession) -> None:
    """A program that asks before the first frame, after a damaged one, or for a field that is not there."""
    assert (session.message(), session.fields(), session.values(0)) == (None, [], 0)
    _, data = sent("zstd", SMALL["velodyne"])
    session.push(data)
    assert session.values(len(session.fields())) == 0
    with pytest.raises(DecodeError):
        session.push(data[:-1])
    assert (session.message(), session.fields(), session.values(0)) == (None, [], 0)


def test_a_program_prints_the_fields_of_a_point(programs: Path) -> None:
    frame, data = sent("predictive", CLOUDS["ouster"])
    given = struct.pack("<I", len(data)) + data
    said = subprocess.run([programs / "print_points"], input=given, capture_output=True, check=True, timeout=60).stdout
    first = frame.cloud()[0]
    assert said.decode().startswith(f"frame 3 of a {frame.sensor.name}: {len(frame.cloud())} points, the first at ")
    for name in ("intensity", "reflectivity", "ambient", "t"):
        assert f", {name} {first[name]:g}" in said.decode()
    for axis in "xyz":  # once, not as fields of the message again
        assert f", {axis} " not in said.decode()
