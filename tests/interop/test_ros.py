"""Without these what leaves for ROS 2 is refused there, or read as other numbers."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from lidarcodec.errors import DecodeError, PacketError, SectionError
from lidarcodec.filling import filled
from lidarcodec.interop import ros
from lidarcodec.interop.cdr import CdrReader
from lidarcodec.interop.point_cloud2 import point_cloud2, tf_message
from lidarcodec.interop.velodyne_scan import packets_of_scan, scan_of
from lidarcodec.packet import Packet
from tests.contracts.frames import received, scene
from tests.packets import turning
from tests.sweeps import examples

typesys = pytest.importorskip("rosbags.typesys", reason="read back by rosbags (extra `bridges`)")


def typestore():
    """Types of ROS 2, and those of the Velodyne driver, out of the definitions that go into our files."""
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    own, _, packet = ros.VELODYNE_SCAN.definition.partition("MSG: velodyne_msgs/VelodynePacket\n")
    store.register(
        typesys.get_types_from_msg(own.split("=" * 80)[0], ros.VELODYNE_SCAN.name)
        | typesys.get_types_from_msg(packet, "velodyne_msgs/msg/VelodynePacket")
    )
    return store


STORE = typestore()
KINDS = {1: "i1", 2: "u1", 3: "<i2", 4: "<u2", 5: "<i4", 6: "<u4", 7: "<f4", 8: "<f8"}


def points_in(message) -> np.ndarray:
    """Points of a deserialised PointCloud2 as rviz takes them apart."""
    assert (message.height, message.is_bigendian, message.is_dense) == (1, False, True)
    assert len(message.data) == message.row_step == message.width * message.point_step
    dtype = np.dtype(
        {
            "names": [field.name for field in message.fields],
            "formats": [KINDS[field.datatype] for field in message.fields],
            "offsets": [field.offset for field in message.fields],
            "itemsize": message.point_step,
        }  # type: ignore[call-overload]
    )
    return np.frombuffer(message.data.tobytes(), dtype)


@pytest.mark.parametrize("known", [ros.POINT_CLOUD2, ros.VELODYNE_SCAN, ros.TF_MESSAGE], ids=lambda one: one.name)
def test_hashes_and_definitions_are_those_of_ros(known: ros.RosType) -> None:
    assert STORE.hash_rihs01(known.name) == known.type_hash
    theirs, _ = STORE.generate_msgdef(known.name, ros_version=2)

    def parts(text: str) -> set[str]:
        return {" ".join(part.split()) for part in text.split("=" * 80)}

    assert parts(theirs) == parts(known.definition)


def test_what_a_receiver_made_up_is_marked() -> None:
    wide = filled(received(scene(5, holes=0.0), "lattice:4"))
    message = STORE.deserialize_cdr(point_cloud2(wide, "car/roof", marks=True), ros.POINT_CLOUD2.name)
    points = points_in(message)
    assert (message.point_step, points.dtype.names[-1]) == (23, "filled")
    assert np.array_equal(points["filled"], wide.filled.T[wide.valid.T])
    assert points["filled"].any()
    assert np.array_equal(points["x"], wide.cloud()["x"])


def test_a_cloud_comes_back_point_for_point_as_velodynes_driver_lays_it_out() -> None:
    frame = scene(7)
    message = STORE.deserialize_cdr(point_cloud2(frame, "car/roof"), ros.POINT_CLOUD2.name)
    assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == frame.stamp_ns
    assert message.header.frame_id == "car/roof"
    points, cloud = points_in(message), frame.cloud()
    assert [(field.name, field.offset) for field in message.fields] == [
        ("x", 0), ("y", 4), ("z", 8), ("intensity", 12), ("ring", 16), ("time", 18)
    ]  # fmt: skip
    assert message.point_step == 22
    assert len(points) == len(cloud) > 0
    for name in ("x", "y", "z", "intensity"):
        assert np.array_equal(points[name], cloud[name]), name
    assert np.array_equal(points["time"], ((cloud["t_ns"] - frame.stamp_ns) * 1e-9).astype("f4"))
    assert np.array_equal(63 - points["ring"].astype(int), cloud["ring"])
    steepness = points["z"] / np.hypot(points["x"], points["y"])
    by_ring = [np.median(steepness[points["ring"] == ring]) for ring in range(64)]
    assert by_ring == sorted(by_ring), "ring 0 is the lowest beam"


@pytest.mark.parametrize("frame_id", ["", "a", "ab", "abc", "abcd", "Fahrzeug/Dach-ä"])
def test_what_follows_a_name_of_any_length_stays_aligned(frame_id: str) -> None:
    frame = scene(1)
    message = STORE.deserialize_cdr(point_cloud2(frame, frame_id), ros.POINT_CLOUD2.name)
    assert message.header.frame_id == frame_id
    assert np.array_equal(points_in(message)["x"], frame.cloud()["x"])
    scan = STORE.deserialize_cdr(scan_of(turning(3), frame_id), ros.VELODYNE_SCAN.name)
    assert scan.header.frame_id == frame_id
    assert [packet.data.tobytes() for packet in scan.packets] == [packet.payload for packet in turning(3)]
    pose = STORE.deserialize_cdr(tf_message(5, "map", frame_id, np.eye(4)), ros.TF_MESSAGE.name).transforms[0]
    assert (pose.header.frame_id, pose.child_frame_id, pose.transform.rotation.w) == ("map", frame_id, 1.0)


def test_a_pose_comes_back() -> None:
    pose = np.array([[0.0, -1.0, 0.0, 3.5], [1.0, 0.0, 0.0, -2.0], [0.0, 0.0, 1.0, 0.25], [0.0, 0.0, 0.0, 1.0]])
    (found,) = STORE.deserialize_cdr(
        tf_message(1_700_000_000_000_000_009, "map", "car", pose), ros.TF_MESSAGE.name
    ).transforms
    assert (found.header.stamp.sec, found.header.stamp.nanosec) == (1_700_000_000, 9)
    moved, turn = found.transform.translation, found.transform.rotation
    assert (moved.x, moved.y, moved.z) == (3.5, -2.0, 0.25)
    assert (turn.x, turn.y, turn.z, turn.w) == pytest.approx((0.0, 0.0, 0.5**0.5, 0.5**0.5))


@pytest.mark.parametrize("count", [1, 2, 348])
def test_packets_come_back_byte_for_byte_with_their_times(count: int) -> None:
    packets = turning(count)
    data = scan_of(packets, "velodyne")
    assert packets_of_scan(data) == packets
    scan = STORE.deserialize_cdr(data, ros.VELODYNE_SCAN.name)
    assert STORE.serialize_cdr(scan, ros.VELODYNE_SCAN.name) == data, "the very bytes of a public package"
    assert [Packet(p.data.tobytes(), p.stamp.sec * 10**9 + p.stamp.nanosec) for p in scan.packets] == packets
    big = STORE.serialize_cdr(scan, ros.VELODYNE_SCAN.name, little_endian=False)
    assert packets_of_scan(big) == packets


def test_times_that_ros_cannot_hold_and_other_payloads_are_refused() -> None:
    assert packets_of_scan(scan_of([Packet(bytes(1206), -1)], ""))[0].stamp_ns == -1
    with pytest.raises(SectionError, match="2038"):
        scan_of([Packet(bytes(1206), 2**31 * 10**9)], "")
    with pytest.raises(PacketError):
        scan_of([Packet(bytes(1205), 0)], "")
    with pytest.raises(SectionError):
        scan_of([], "")


@pytest.mark.drawn
def test_bad_scans_raise_our_errors_before_memory_is_taken() -> None:
    data = bytearray(scan_of(turning(2), "velodyne"))
    assert packets_of_scan(scan_of(turning(1), "a")[: 4 + 8 + 8] + bytes(4)) == [], "a scan without packets"
    for cut in range(0, len(data), 7):
        with pytest.raises(DecodeError):
            packets_of_scan(bytes(data[:cut]))
    huge = data.copy()
    huge[28:32] = struct.pack("<I", 2**32 - 1)
    with pytest.raises(DecodeError, match="needs"):
        packets_of_scan(bytes(huge))
    rng = np.random.default_rng(5)
    for _ in range(examples(400)):
        mutant = data.copy()
        for at in rng.integers(0, 60, 3):
            mutant[at] = rng.integers(256)
        try:
            packets_of_scan(bytes(mutant))
        except DecodeError:
            continue


def test_other_forms_of_cdr_are_told_from_this_one() -> None:
    for form in (b"", b"\0\1", b"\0\7\0\0", b"\1\0\0\0"):
        with pytest.raises(SectionError, match="not in plain CDR"):
            CdrReader(form + bytes(8) if len(form) == 4 else form)
