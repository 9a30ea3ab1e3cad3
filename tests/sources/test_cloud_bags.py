"""What a user loses if these fail: the clouds in bags of ROS 1 and ROS 2, and the trust that a bad one does no harm."""

from __future__ import annotations

import shutil
import sqlite3
import struct
from contextlib import closing

import numpy as np
import pytest

from lidarcodec.errors import LidarCodecError, SourceError
from lidarcodec.interop import ros
from lidarcodec.interop.point_cloud2 import cdr_of
from lidarcodec.interop.velodyne_scan import scan_of
from lidarcodec.recording import RosbagWriter
from lidarcodec.sensors.clouds.message import ROS1
from lidarcodec.sources import open_source
from tests import packets as made
from tests.packets import packets_in
from tests.point_clouds import STAMP_NS, message, ouster, ros1, velodyne
from tests.sweeps import examples

MESSAGES = [message(velodyne(60, seed=n), stamp_ns=STAMP_NS + n * 10**8) for n in range(3)]


def bag1(path, payloads, compression=b"none", topic=b"/points", kind=b"sensor_msgs/PointCloud2"):
    """A bag of ROS 1 as its format says, a chunk a message."""

    def record(head: dict[bytes, bytes], data: bytes) -> bytes:
        fields = b"".join(struct.pack("<I", len(n) + 1 + len(v)) + n + b"=" + v for n, v in head.items())
        return struct.pack("<I", len(fields)) + fields + struct.pack("<I", len(data)) + data

    out = b"#ROSBAG V2.0\n" + record({b"op": b"\3", b"index_pos": bytes(8)}, b" " * 100)
    about = struct.pack("<I", 5 + len(kind)) + b"type=" + kind
    for number, payload in enumerate(payloads):
        inner = record({b"op": b"\7", b"conn": bytes(4), b"topic": topic}, about)
        inner += record({b"op": b"\2", b"conn": bytes(4), b"time": struct.pack("<II", number, 0)}, payload)
        packed = {b"none": bytes, b"bz2": __import__("bz2").compress, b"lz4": _lz4}[compression](inner)
        out += record({b"op": b"\5", b"compression": compression, b"size": struct.pack("<I", len(inner))}, packed)
    path.write_bytes(out + record({b"op": b"\6"}, b"index"))
    return path


def _lz4(data: bytes) -> bytes:
    import lz4.frame

    return bytes(lz4.frame.compress(data))


def payloads_of(path) -> list[bytes]:
    with open_source(path) as source:
        assert source.sensor.model == "pointcloud2"
        packets = list(source.packets())
    assert [packet.stamp_ns for packet in packets] == [STAMP_NS + n * 10**8 for n in range(len(packets))]
    return [packet.payload for packet in packets]


@pytest.mark.parametrize("compression", [b"none", b"bz2", b"lz4"])
def test_a_bag_of_ros_1_gives_the_very_messages(tmp_path, compression):
    plain = [ros1(one)[len(ROS1) :] for one in MESSAGES]
    path = bag1(tmp_path / "a.bag", plain, compression)
    assert payloads_of(path) == [ROS1 + one for one in plain]
    assert [cdr_of(ROS1 + one) for one in plain] == MESSAGES


def test_a_bag_of_ros_1_from_a_public_package_is_read(tmp_path):
    rosbag1 = pytest.importorskip("rosbags.rosbag1", reason="written by rosbags (extra `bridges`)")
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    plain = [ros1(one)[len(ROS1) :] for one in MESSAGES]
    writer = rosbag1.Writer(tmp_path / "a.bag")
    writer.set_compression(rosbag1.Writer.CompressionFormat.LZ4)
    with writer:
        connection = writer.add_connection("/lidar/points", ros.POINT_CLOUD2.name, typestore=store)
        for number, one in enumerate(plain):
            writer.write(connection, number, one)
    assert payloads_of(tmp_path / "a.bag") == [ROS1 + one for one in plain]


@pytest.mark.parametrize("storage", ["MCAP", "SQLITE3"])
def test_a_bag_of_ros_2_gives_the_very_messages(tmp_path, storage):
    rosbag2 = pytest.importorskip("rosbags.rosbag2", reason="written by rosbags (extra `bridges`)")
    from tests.interop.test_ros import STORE

    with rosbag2.Writer(tmp_path / "bag", version=8, storage_plugin=rosbag2.StoragePlugin[storage]) as writer:
        connection = writer.add_connection("/points", ros.POINT_CLOUD2.name, typestore=STORE)
        for number, one in enumerate(MESSAGES):
            writer.write(connection, number, one)
    assert payloads_of(tmp_path / "bag") == MESSAGES


def both(path):
    """A bag with packets, and with clouds on two topics."""
    with path.open("wb") as file, RosbagWriter(file) as writer:
        writer.write_scan(made.turning(30))
        writer.write_message(STAMP_NS, MESSAGES[0])
    other = path.with_name("clouds.mcap")
    with other.open("wb") as file, RosbagWriter(file, points_topic="/a") as writer:
        writer.write_message(STAMP_NS, MESSAGES[0])
        writer._points_topic = "/b"
        writer.write_message(STAMP_NS, MESSAGES[1])
    return path, other


def test_packets_are_preferred_to_clouds_and_a_topic_or_model_chooses(tmp_path):
    bag, clouds = both(tmp_path / "both.mcap")
    with open_source(bag) as source:
        assert source.sensor.model == "hdl64e"
    for spec in (f"{bag}?model=pointcloud2", f"{bag}?topic=/velodyne_points"):
        assert payloads_of(spec) == MESSAGES[:1]
    with pytest.raises(SourceError, match=r"several topics.*/a, /b"):
        open_source(clouds)
    assert payloads_of(f"{clouds}?topic=/a") == MESSAGES[:1]
    with pytest.raises(SourceError, match="/c: choose one of /a, /b"):
        open_source(f"{clouds}?topic=/c")


def test_a_cut_bag_gives_what_is_before_its_end(tmp_path):
    plain = [ros1(one)[len(ROS1) :] for one in MESSAGES]
    path = bag1(tmp_path / "a.bag", plain)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) - len(plain[2]) // 2])
    with open_source(path) as source:
        assert len(list(source.packets())) == 2
        assert source.counts["damaged"] == 1


def test_a_bag_of_other_messages_says_what_is_missing(tmp_path):
    path = bag1(tmp_path / "a.bag", [b"text"], kind=b"std_msgs/String")
    with pytest.raises(
        SourceError, match="has no sensor_msgs/PointCloud2: the types of its topics are std_msgs/String"
    ):
        open_source(path)


@pytest.mark.sweep
def test_chunks_that_expand_without_end_are_refused(tmp_path):
    path = bag1(tmp_path / "a.bag", [bytes(40_000_000)] * 3, b"bz2")
    with pytest.raises(SourceError, match=r"neither|readable"):
        open_source(path)


@pytest.mark.drawn
def test_damaged_bags_end_in_our_errors(tmp_path):
    rng = np.random.default_rng(2)
    whole = bag1(tmp_path / "a.bag", [ros1(one)[len(ROS1) :] for one in MESSAGES]).read_bytes()
    for _ in range(examples(60)):
        damaged = bytearray(whole)
        for _ in range(3):
            damaged[int(rng.integers(13, 400 if rng.random() < 0.7 else len(damaged)))] = int(rng.integers(0, 256))
        (tmp_path / "b.bag").write_bytes(damaged)
        try:
            packets_in(tmp_path / "b.bag")
        except LidarCodecError:
            continue


def test_a_message_that_is_no_cloud_travels_too(tmp_path):
    """The next one keeps its place, and nothing is lost."""
    path = tmp_path / "a.db3"
    rows = [MESSAGES[0], b"\0\1\0\0no cloud", MESSAGES[1]]
    with closing(sqlite3.connect(path)) as bag:
        bag.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT)")
        bag.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INT, timestamp INT, data BLOB)")
        bag.execute("INSERT INTO topics VALUES (1, '/points', ?, 'cdr')", (ros.POINT_CLOUD2.name,))
        for number, row in enumerate(rows):
            bag.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES (1, ?, ?)", (number, row))
        bag.commit()
    packets = packets_in(path)
    assert [packet.payload for packet in packets] == rows
    assert packets[1].stamp_ns == packets[0].stamp_ns


def test_a_folder_of_a_bag_is_read_without_its_metadata_being_changed(tmp_path):
    name = "bag_0.mcap"
    (tmp_path / "bag").mkdir()
    with (tmp_path / "bag" / name).open("wb") as file, RosbagWriter(file, points_topic="/points") as writer:
        for number, one in enumerate(MESSAGES):
            writer.write_message(STAMP_NS + number * 10**8, one)
    (tmp_path / "bag" / "metadata.yaml").write_text(writer.metadata(name))
    assert payloads_of(tmp_path / "bag") == MESSAGES
    shutil.rmtree(tmp_path / "bag")


def test_scans_in_a_bag_of_ros_1_are_not_taken_for_clouds(tmp_path):
    path = bag1(tmp_path / "a.bag", [scan_of(made.turning(3), "v")], kind=b"velodyne_msgs/VelodyneScan")
    with pytest.raises(
        SourceError, match="has no sensor_msgs/PointCloud2: the types of its topics are velodyne_msgs/VelodyneScan"
    ):
        open_source(path)


def test_an_organised_cloud_has_the_rows_of_its_sensor(tmp_path):
    path = bag1(tmp_path / "a.bag", [ros1(message(ouster(), 16))[len(ROS1) :]])
    with open_source(path) as source:
        assert source.sensor.rows == 16
        assert source.sensor.name == "PointCloud2 lidar"
