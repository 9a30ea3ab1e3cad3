"""Frames with the pose of the sensor at their first packet, from a file of poses, and with its mounting."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from lidarcodec.frame import Frame
from lidarcodec.mounting import Mounting
from lidarcodec.sources.poses import Poses


def posed(frame: Frame, poses: Poses | None, shift_ns: int = 0, mount: Mounting | None = None) -> Frame:
    """The frame with its pose and its mounting; unchanged where neither is known.

    shift_ns: time of the frame's stamps minus time of the source's (a replay gives new stamps).
    """
    pose = None if poses is None else poses.at(frame.stamp_ns - shift_ns)
    if poses is not None and pose is None:
        poses.tell_unknown(frame.stamp_ns - shift_ns)
    changes = {} if pose is None else {"pose": pose}
    if mount is not None:
        changes["mount"] = mount.T_vehicle_sensor
    return frame.with_(**changes) if changes else frame


def with_poses(frames: Iterable[Frame], poses: Poses | None, mount: Mounting | None = None) -> Iterator[Frame]:
    """Frames, each with its pose where one is known, and with the mounting of the sensor."""
    return (posed(frame, poses, mount=mount) for frame in frames)
