"""Coded messages in ROS 2's type for compressed clouds: without these no bag, bridge or plug-in takes them."""

from __future__ import annotations

import struct

import pytest

from lidarcodec import wire
from lidarcodec.errors import DecodeError, SectionError
from lidarcodec.interop import ros
from lidarcodec.interop.compressed_cloud import FORMAT, compressed_cloud, message_of
from lidarcodec.interop.point_cloud2 import point_cloud2
from tests.contracts.frames import scene

typesys = pytest.importorskip("rosbags.typesys", reason="read back by rosbags (extra `bridges`)")
from tests.interop.test_ros import STORE  # noqa: E402

NAME = ros.COMPRESSED_CLOUD.name
STORE.register(typesys.get_types_from_msg(ros.COMPRESSED_CLOUD.definition.split("=" * 80)[0], NAME))
MESSAGE = bytes(range(256)) * 3
STAMP_NS = 1_700_000_000_000_000_123


def test_the_hash_is_that_of_the_type() -> None:
    assert STORE.hash_rihs01(NAME) == ros.COMPRESSED_CLOUD.type_hash


@pytest.mark.parametrize("frame_id", ["", "a", "abc", "car-7/roof"])
@pytest.mark.parametrize("size", [0, 1, 766, 768])
def test_a_public_package_reads_it_and_writes_the_same_bytes(frame_id: str, size: int) -> None:
    data = compressed_cloud(MESSAGE[:size], STAMP_NS, frame_id)
    found = STORE.deserialize_cdr(data, NAME)
    assert (found.header.frame_id, found.header.stamp.nanosec, found.format) == (frame_id, 123, FORMAT)
    assert found.compressed_data.tobytes() == MESSAGE[:size]
    assert STORE.serialize_cdr(found, NAME) == data
    for little in (True, False):
        assert message_of(STORE.serialize_cdr(found, NAME, little_endian=little)) == MESSAGE[:size]


def test_its_fields_are_those_of_the_cloud_that_a_decoder_gives() -> None:
    cloud = STORE.deserialize_cdr(point_cloud2(scene(7), "roof"), ros.POINT_CLOUD2.name)
    found = STORE.deserialize_cdr(compressed_cloud(b"", 0, "roof"), NAME)
    assert (found.fields, found.point_step, found.height) == (cloud.fields, cloud.point_step, cloud.height)


def test_other_formats_and_damaged_messages_are_our_errors() -> None:
    data = compressed_cloud(MESSAGE, STAMP_NS, "roof")
    other = STORE.deserialize_cdr(data, NAME)
    other.format = "draco"
    with pytest.raises(SectionError, match="format 'draco'"):
        message_of(bytes(STORE.serialize_cdr(other, NAME)))
    for cut in range(len(data)):
        with pytest.raises(DecodeError):
            message_of(data[:cut])
    at = data.index(struct.pack("<I", 6), 20)  # the number of fields
    for many in (7, 2**16, 2**32 - 1):
        with pytest.raises(DecodeError):
            message_of(data[:at] + struct.pack("<I", many) + data[at + 4 :])
    with pytest.raises(DecodeError):
        wire.unpack(message_of(data))
