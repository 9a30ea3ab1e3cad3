"""Points of a frame that is a `sensor_msgs/PointCloud2` message, with the fields of the message."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import DecodeError
from lidarcodec.packet_rest import PacketRest
from lidarcodec.sensors.clouds.message import MAX_POINTS, CloudMessage, read_message
from lidarcodec.sensors.clouds.values import intensity_of, times_ns
from lidarcodec.sensors.clouds.view import view_of

if TYPE_CHECKING:
    from lidarcodec.frame import Frame


def payload_of(frame: Frame) -> bytes:
    """The message of a frame of a point cloud."""
    assert isinstance(frame.side, PacketRest)
    return frame.side.odd_packets[0]


def cloud_points(frame: Frame, *, both: bool) -> npt.NDArray[np.void]:
    """(N,) structured array of the points with a return, in the order of the message: `x y z` f4, `intensity` as of the
    frame, `laser` u1 (the message's ring), `ring` u1 (row), `t_ns` i8, and the message's other fields of one value.

    both: with a field `return_number`, which is 1
    """
    try:
        message = read_message(payload_of(frame))
    except DecodeError:
        return np.empty(0, _dtype(frame, None, both=both))
    dtype = _dtype(frame, message, both=both)
    if message.head.points > MAX_POINTS or message.xyz is None:
        return np.empty(0, dtype)
    chosen = message.returns
    points = np.zeros(int(np.count_nonzero(chosen)), dtype)
    for name, axis in zip("xyz", message.xyz, strict=True):
        points[name] = axis[chosen]
    points["intensity"] = intensity_of(message)[chosen]
    for name in dtype.names or ():
        if name not in _OWN:
            points[name] = message.values(name)[chosen]  # type: ignore[index]
    view = view_of(message, frame.sensor.rows)
    if view is not None:
        points["ring"] = np.clip(view.row, 0, frame.sensor.rows - 1)[chosen]
    rings = message.values("ring")
    if rings is None:
        points["laser"] = points["ring"]
    else:
        with np.errstate(invalid="ignore"):  # a ring may be NaN
            points["laser"] = rings[chosen].astype(np.int64) & 0xFF
    if both:
        points["return_number"] = 1
    points["t_ns"] = frame.stamp_ns + times_ns(message)[chosen]
    return points


_OWN: Final = ("x", "y", "z", "intensity", "laser", "ring", "t_ns", "return_number")


def _dtype(frame: Frame, message: CloudMessage | None, *, both: bool) -> np.dtype[np.void]:
    fields: list[tuple[str, npt.DTypeLike]] = [("x", "f4"), ("y", "f4"), ("z", "f4")]
    fields += [("intensity", frame.intensity.dtype), ("laser", "u1"), ("ring", "u1"), ("t_ns", "i8")]
    if message is not None:
        fields += [(name, one.kind) for name, one in message.head.by_name.items() if name and name not in _OWN]
    return np.dtype(fields + ([("return_number", "u1")] if both else []))
