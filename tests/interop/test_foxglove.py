"""Without these a cloud that left as Foxglove's message may come out of a viewer as another one, or as none."""

from __future__ import annotations

import numpy as np
import pytest

from lidarcodec.filling import filled
from lidarcodec.interop import foxglove
from lidarcodec.interop.poses import quaternion_of
from lidarcodec.interop.protobuf import varint
from lidarcodec.side import SideInfo
from tests.contracts.frames import received, scene

pytest.importorskip("foxglove_schemas_protobuf", reason="read back by foxglove-schemas-protobuf")
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from google.protobuf import descriptor_pb2, descriptor_pool


def turned(x: float, y: float, z: float, w: float) -> np.ndarray:
    """A pose with the rotation of a quaternion of length 1."""
    pose = np.eye(4)
    pose[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    pose[:3, 3] = (5.0, -2.5, 1.25)
    return pose


def points_in(message: PointCloud) -> np.ndarray:
    """Points as a viewer takes them apart: by the fields that the message itself names."""
    kinds = {"UINT8": "u1", "UINT32": "<u4", "FLOAT32": "<f4"}
    names = [field.name for field in message.fields]
    formats = [kinds[field.NumericType.Name(field.type)] for field in message.fields]
    offsets = [field.offset for field in message.fields]
    dtype = np.dtype(
        {"names": names, "formats": formats, "offsets": offsets, "itemsize": message.point_stride}  # type: ignore[call-overload]
    )
    return np.frombuffer(message.data, dtype)


@pytest.mark.parametrize("schema", [foxglove.POINT_CLOUD, foxglove.FRAME_TRANSFORM], ids=lambda schema: schema.name)
def test_the_schema_is_foxgloves_own(schema: foxglove.Schema) -> None:
    files = descriptor_pb2.FileDescriptorSet.FromString(schema.data).file
    pool = descriptor_pool.DescriptorPool()
    for file in files:
        pool.Add(file)  # each after what it imports
    public = {"foxglove.PointCloud": PointCloud, "foxglove.FrameTransform": FrameTransform}[schema.name].DESCRIPTOR

    def compare(ours, theirs) -> None:
        assert ours.full_name == theirs.full_name
        for mine, other in zip(ours.fields, theirs.fields, strict=True):
            assert (mine.name, mine.number, mine.type, mine.is_repeated) == (
                other.name,
                other.number,
                other.type,
                other.is_repeated,
            )
            if other.message_type is not None:
                compare(mine.message_type, other.message_type)
            if other.enum_type is not None:
                assert [(v.name, v.number) for v in mine.enum_type.values] == [
                    (v.name, v.number) for v in other.enum_type.values
                ]

    compare(pool.FindMessageTypeByName(schema.name), public)


@pytest.mark.parametrize("step", [1, 4])
def test_what_a_receiver_made_up_is_marked(step: int) -> None:
    wide = filled(received(scene(5, holes=0.0), f"lattice:{step}"))
    points = points_in(PointCloud.FromString(foxglove.point_cloud(wide, "car/roof", marks=True)))
    assert points.dtype.names == ("x", "y", "z", "intensity", "ring", "t_ns", "filled")
    expected = np.zeros(wide.range.shape, bool) if wide.filled is None else wide.filled
    assert np.array_equal(points["filled"], expected.T[wide.valid.T])
    assert np.array_equal(points["x"], wide.cloud()["x"])
    assert points["filled"].any() == (step > 1)


def test_a_cloud_comes_back_point_for_point() -> None:
    frame = scene(5)
    message = PointCloud.FromString(foxglove.point_cloud(frame, "car/roof"))
    assert message.timestamp.seconds * 10**9 + message.timestamp.nanos == frame.stamp_ns
    assert message.frame_id == "car/roof"
    assert message.pose.orientation.w == 1.0
    points, cloud = points_in(message), frame.cloud()
    assert len(points) == len(cloud) > 0
    for name in ("x", "y", "z", "intensity", "ring"):
        assert np.array_equal(points[name], cloud[name]), name
    assert np.array_equal(points["t_ns"].astype("i8") + frame.stamp_ns, cloud["t_ns"])


def test_a_frame_without_points_and_times_that_do_not_fit_are_messages_too() -> None:
    frame = scene(5)
    empty = frame.with_(range=np.zeros_like(frame.range))
    assert len(points_in(PointCloud.FromString(foxglove.point_cloud(empty, "a")))) == 0
    side = frame.side or SideInfo.regular(frame.width // 6)
    away = np.where(np.arange(side.packets) % 2, -(10**12), 10**12)
    odd = frame.with_(
        side=SideInfo(away, side.gps_us, side.status, side.layouts, side.layout, side.irregular, side.second)
    )
    times = points_in(PointCloud.FromString(foxglove.point_cloud(odd, "a")))["t_ns"]
    assert set(np.unique(times)) == {0, 2**32 - 1}


@pytest.mark.parametrize("stamp_ns", [0, 1, -1, 1_700_000_000_123_456_789, -1_500_000_000])
def test_a_pose_comes_back_with_its_time(stamp_ns: int) -> None:
    rng = np.random.default_rng(7)
    for _ in range(20):
        quaternion = rng.normal(size=4)
        quaternion *= np.copysign(1 / np.linalg.norm(quaternion), quaternion[3])
        pose = turned(*quaternion)
        found = FrameTransform.FromString(foxglove.frame_transform(stamp_ns, "world", "car/roof", pose))
        assert found.timestamp.seconds * 10**9 + found.timestamp.nanos == stamp_ns
        assert (found.parent_frame_id, found.child_frame_id) == ("world", "car/roof")
        assert [found.translation.x, found.translation.y, found.translation.z] == [5.0, -2.5, 1.25]
        assert [getattr(found.rotation, axis) for axis in "xyzw"] == pytest.approx(quaternion, abs=1e-12)


def test_half_turns_have_a_quaternion_too() -> None:
    for axis in range(3):
        wanted = [0.0, 0.0, 0.0, 0.0]
        wanted[axis] = 1.0
        assert np.abs(quaternion_of(turned(*wanted))) == pytest.approx(wanted, abs=1e-12)


def test_whole_numbers_take_as_many_bytes_as_they_need() -> None:
    assert [len(varint(value)) for value in (0, 127, 128, 2**63, -1)] == [1, 1, 2, 10, 10]
