"""`sensor_msgs/PointCloud2` as the ROS driver of Velodyne lays it out (XYZIRT), and `tf2_msgs/TFMessage`.

A point has 22 bytes: x y z intensity float32, ring uint16, time float32. Its ring counts from the lowest beam up, as
the driver's does, and not from the highest down as `Frame` has it; its time is in seconds after the message's.
With marks it has 23: `filled`, uint8, is 1 for a return that a receiver made up. With both returns of each beam it has
another byte: `return_number`, 1 or 2.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.cloud import Returns
from lidarcodec.errors import DecodeError, SectionError
from lidarcodec.filling import made_up
from lidarcodec.frame import Frame
from lidarcodec.interop.cdr import CdrWriter
from lidarcodec.interop.poses import quaternion_of
from lidarcodec.sensors.clouds.message import ROS1, TYPE_NUMBERS, read_head
from lidarcodec.sensors.clouds.points import payload_of

POINT_DTYPE: Final = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("ring", "<u2"), ("time", "<f4")]
)
MARKED_DTYPE: Final = np.dtype([*POINT_DTYPE.descr, ("filled", "u1")])
NUMBERED_DTYPE: Final = np.dtype([*POINT_DTYPE.descr, ("return_number", "u1")])
DATATYPES: Final = {"|u1": 2, "<u2": 4, "<f4": 7}


def points_of(frame: Frame, *, marks: bool = False, returns: Returns = "first") -> npt.NDArray[np.void]:
    """(N,) POINT_DTYPE, the points of `Frame.cloud` in its order; with marks MARKED_DTYPE, of all returns with
    `return_number`. Marks are for first returns only."""
    cloud = frame.cloud(returns)
    dtype = MARKED_DTYPE if marks else POINT_DTYPE
    points = np.empty(len(cloud), NUMBERED_DTYPE if returns == "all" else dtype)
    if marks and returns == "first":
        points["filled"] = 0 if frame.filled is None else made_up(frame)
    for name in ("x", "y", "z", "intensity"):
        points[name] = cloud[name]
    points["ring"] = frame.sensor.rows - 1 - cloud["ring"].astype(np.uint16)
    points["time"] = (cloud["t_ns"] - frame.stamp_ns) * 1e-9
    if returns == "all":
        points["return_number"] = cloud["return_number"]
    return points


def point_cloud2(frame: Frame, frame_id: str, *, marks: bool = False, returns: Returns = "first") -> bytes:
    """A frame as a message, stamped with the time of its first packet. Cost: 8 ms for 120,000 points.

    A frame that is a PointCloud2 message is that message, with the frame_id that it came with.
    """
    if frame.sensor.is_cloud:
        return cdr_of(payload_of(frame))
    points = points_of(frame, marks=marks, returns=returns)
    writer = CdrWriter().header(frame.stamp_ns, frame_id).u32(1).u32(len(points)).u32(len(points.dtype.names or ()))
    for name, (dtype, offset, *_) in dict(points.dtype.fields or {}).items():
        writer.text(name).u32(offset).u8(DATATYPES[dtype.str]).u32(1)
    writer.u8(0).u32(points.dtype.itemsize).u32(points.nbytes)
    return writer.u32(points.nbytes).raw(points.tobytes()).u8(1).done()


def frame_of_points(frame: Frame, otherwise: str) -> str:
    """The frame_id of what `point_cloud2` makes of a frame: that of the message, where it is one and has one."""
    if not frame.sensor.is_cloud:
        return otherwise
    try:
        return read_head(payload_of(frame)).frame_id or otherwise
    except DecodeError:  # no PointCloud2
        return otherwise


def cdr_of(payload: bytes) -> bytes:
    """A PointCloud2 payload (lidarcodec/sensors/clouds/message.py) as a message of ROS 2.

    One of ROS 1 loses its sequence number.

    Raises SectionError for what is no PointCloud2, TruncatedError.
    """
    head = read_head(payload)
    if payload[:4] != ROS1:
        return payload
    data = payload[head.size : head.size + head.data_bytes]
    if len(data) < head.data_bytes or len(payload) != head.size + head.data_bytes + 1:
        raise SectionError("a PointCloud2 of ROS 1 ends before its last point")
    writer = CdrWriter().header(head.stamp_ns, head.frame_id).u32(head.height).u32(head.width).u32(len(head.fields))
    for one in head.fields:
        writer.text(one.name).u32(one.offset).u8(TYPE_NUMBERS[one.kind]).u32(one.repeated)
    writer.u8(int(head.big_endian)).u32(head.point_step).u32(head.row_step).u32(len(data))
    return writer.raw(data).u8(payload[-1]).done()


def tf_message(stamp_ns: int, parent: str, child: str, T_parent_child: npt.NDArray[np.float64]) -> bytes:
    """A pose, (4, 4) float64, as a message with one transform."""
    writer = CdrWriter().u32(1).header(stamp_ns, parent).text(child)
    for value in (*T_parent_child[:3, 3].tolist(), *quaternion_of(T_parent_child)):
        writer.f64(value)
    return writer.done()
