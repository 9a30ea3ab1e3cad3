"""Foxglove's messages `foxglove.PointCloud` and `foxglove.FrameTransform`, in protobuf, and the schemas of both.

A point has 18 bytes: x y z float32 in metres (x forward, y left, z up), intensity and ring uint8, and `t_ns`, uint32,
its time after the message's in nanoseconds (held at 4.29 s, and at 0 where a packet is stamped before the first one).
The intensity of a sensor that sends 16 bits is uint16, and a point has 19 bytes. The fields of the message say which.
With marks it has one more: `filled`, uint8, is 1 for a return that a receiver made up.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec.filling import made_up
from lidarcodec.frame import Frame
from lidarcodec.interop.poses import quaternion_of
from lidarcodec.interop.protobuf import (
    BYTES,
    DOUBLE,
    ENUM,
    FIXED32,
    INT32,
    INT64,
    MESSAGE,
    STRING,
    Field,
    Fields,
    File,
    MessageType,
    descriptor_set,
)
from lidarcodec.mounting import vehicle_pose

POINT_DTYPE: Final = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "u1"), ("ring", "u1"), ("t_ns", "<u4")]
)
MARKED_DTYPE: Final = np.dtype([*POINT_DTYPE.descr, ("filled", "u1")])
ENCODING: Final = "protobuf"
WORLD: Final = "world"
"""The frame in which poses are given."""

_NUMERIC_TYPES: Final = {"|u1": 1, "|i1": 2, "<u2": 3, "<i2": 4, "<u4": 5, "<i4": 6, "<f4": 7, "<f8": 8}
_TIME, _VECTOR, _QUATERNION, _POSE, _ELEMENT, _CLOUD, _TRANSFORM = (
    File("google/protobuf/timestamp.proto", "google.protobuf", (), MessageType(
        "Timestamp", (Field("seconds", 1, INT64), Field("nanos", 2, INT32)))),
    File("foxglove/Vector3.proto", "foxglove", (), MessageType(
        "Vector3", tuple(Field(axis, at, DOUBLE) for at, axis in enumerate("xyz", 1)))),
    File("foxglove/Quaternion.proto", "foxglove", (), MessageType(
        "Quaternion", tuple(Field(axis, at, DOUBLE) for at, axis in enumerate("xyzw", 1)))),
    File("foxglove/Pose.proto", "foxglove", ("foxglove/Quaternion.proto", "foxglove/Vector3.proto"), MessageType(
        "Pose", (Field("position", 1, MESSAGE, "foxglove.Vector3"),
                 Field("orientation", 2, MESSAGE, "foxglove.Quaternion")))),
    File("foxglove/PackedElementField.proto", "foxglove", (), MessageType(
        "PackedElementField",
        (Field("name", 1, STRING), Field("offset", 2, FIXED32),
         Field("type", 3, ENUM, "foxglove.PackedElementField.NumericType")),
        (("NumericType", ("UNKNOWN", "UINT8", "INT8", "UINT16", "INT16", "UINT32", "INT32", "FLOAT32", "FLOAT64")),))),
    File(
        "foxglove/PointCloud.proto", "foxglove",
        ("foxglove/PackedElementField.proto", "foxglove/Pose.proto", "google/protobuf/timestamp.proto"),
        MessageType("PointCloud", (
            Field("timestamp", 1, MESSAGE, "google.protobuf.Timestamp"), Field("frame_id", 2, STRING),
            Field("pose", 3, MESSAGE, "foxglove.Pose"), Field("point_stride", 4, FIXED32),
            Field("fields", 5, MESSAGE, "foxglove.PackedElementField", repeated=True), Field("data", 6, BYTES)))),
    File(
        "foxglove/FrameTransform.proto", "foxglove",
        ("foxglove/Quaternion.proto", "foxglove/Vector3.proto", "google/protobuf/timestamp.proto"),
        MessageType("FrameTransform", (
            Field("timestamp", 1, MESSAGE, "google.protobuf.Timestamp"), Field("parent_frame_id", 2, STRING),
            Field("child_frame_id", 3, STRING), Field("translation", 4, MESSAGE, "foxglove.Vector3"),
            Field("rotation", 5, MESSAGE, "foxglove.Quaternion")))),
)  # fmt: skip


class Schema(NamedTuple):
    """A type's name, and the FileDescriptorSet that describes it."""

    name: str
    data: bytes


POINT_CLOUD: Final = Schema(
    "foxglove.PointCloud", descriptor_set((_TIME, _VECTOR, _QUATERNION, _POSE, _ELEMENT, _CLOUD))
)
FRAME_TRANSFORM: Final = Schema("foxglove.FrameTransform", descriptor_set((_TIME, _VECTOR, _QUATERNION, _TRANSFORM)))
SCHEMAS: Final = {schema.name: schema for schema in (POINT_CLOUD, FRAME_TRANSFORM)}


def points_of(frame: Frame, *, marks: bool = False) -> npt.NDArray[np.void]:
    """(N,) POINT_DTYPE, the points of `Frame.cloud` in its order; with marks MARKED_DTYPE.

    The intensity is uint16 if the sensor sends so many bits. A cloud that came as a message has its other fields.
    """
    cloud = frame.cloud()
    points = np.empty(len(cloud), _dtype_of(cloud["intensity"].dtype, marks=marks))
    further = further_fields(cloud.dtype) if frame.sensor.is_cloud else []
    if further:
        points = np.empty(len(cloud), [*points.dtype.descr, *further])
        for name, _ in further:
            points[name] = cloud[name]
    if marks:
        points["filled"] = 0 if frame.filled is None else made_up(frame)
    for name in ("x", "y", "z", "intensity", "ring"):
        points[name] = cloud[name]
    points["t_ns"] = np.clip(cloud["t_ns"] - frame.stamp_ns, 0, 2**32 - 1)
    return points


def further_fields(dtype: np.dtype[np.void]) -> list[tuple[str, str]]:
    """Name and type of the fields of a cloud that POINT_DTYPE does not have, as far as Foxglove has their types."""
    own = {*(POINT_DTYPE.names or ()), "laser", "return_number", "filled"}
    found = [(name, dtype[name].newbyteorder("<").str) for name in dtype.names or () if name not in own]
    return [(name, kind) for name, kind in found if kind in _NUMERIC_TYPES]


def point_cloud(frame: Frame, frame_id: str, *, marks: bool = False) -> bytes:
    """A frame as `foxglove.PointCloud`. Cost: 7 ms for 120,000 points, most of it for the cloud itself."""
    return cloud_message(frame.stamp_ns, frame_id, points_of(frame, marks=marks))


def cloud_message(stamp_ns: int, frame_id: str, points: npt.NDArray[np.void]) -> bytes:
    """(N,) points as `points_of` gives them, whatever they are of, as `foxglove.PointCloud`."""
    fields = Fields().data(1, _time(stamp_ns)).text(2, frame_id).data(3, _IDENTITY)
    fields.fixed32(4, points.dtype.itemsize)
    for element in _elements(points.dtype):
        fields.data(5, element)
    return fields.data(6, points.tobytes()).done()


def frame_transform(stamp_ns: int, parent: str, child: str, T_parent_child: npt.NDArray[np.float64]) -> bytes:
    """A pose, (4, 4) float64, as `foxglove.FrameTransform`."""
    fields = Fields().data(1, _time(stamp_ns)).text(2, parent).text(3, child)
    fields.data(4, _doubles(T_parent_child[:3, 3].tolist()))
    return fields.data(5, _doubles(quaternion_of(T_parent_child))).done()


def transforms_of(frame: Frame, vehicle: str, sensor: str) -> tuple[bytes | None, bytes | None]:
    """The pose and the mounting of a frame as `foxglove.FrameTransform`, each None where it is not known.

    vehicle, sensor: names of their frames. The pose is that of the vehicle where the mounting is known, because a frame
    of Foxglove has a single parent; otherwise that of the sensor.
    """
    pose = mount = None
    if frame.pose is not None:
        child = sensor if frame.mount is None else vehicle
        pose = frame_transform(frame.stamp_ns, WORLD, child, vehicle_pose(frame.pose, frame.mount))
    if frame.mount is not None:
        mount = frame_transform(frame.stamp_ns, vehicle, sensor, frame.mount)
    return pose, mount


def _time(stamp_ns: int) -> bytes:
    seconds, nanos = divmod(stamp_ns, 10**9)
    return Fields().varint(1, seconds).varint(2, nanos).done()


def _doubles(values: list[float]) -> bytes:
    fields = Fields()
    for number, value in enumerate(values, 1):
        fields.double(number, value)
    return fields.done()


def _dtype_of(intensity: np.dtype[Any], *, marks: bool) -> np.dtype[np.void]:
    dtype = MARKED_DTYPE if marks else POINT_DTYPE
    if intensity.itemsize == 1:
        return dtype
    return np.dtype([(name, "<u2" if name == "intensity" else dtype[name]) for name in dtype.names or ()])


@lru_cache(maxsize=8)
def _elements(dtype: np.dtype[np.void]) -> tuple[bytes, ...]:
    return tuple(
        Fields().text(1, name).fixed32(2, offset).varint(3, _NUMERIC_TYPES[form.str]).done()
        for name, (form, offset, *_) in dict(dtype.fields or {}).items()
    )


_IDENTITY: Final = Fields().data(1, _doubles([0.0, 0.0, 0.0])).data(2, _doubles([0.0, 0.0, 0.0, 1.0])).done()
