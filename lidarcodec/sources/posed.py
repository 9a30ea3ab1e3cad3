"""Frames with the pose of the sensor at their first packet, from a file of poses."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from lidarcodec.frame import Frame
from lidarcodec.sources.poses import Poses


def posed(frame: Frame, poses: Poses | None, shift_ns: int = 0) -> Frame:
    """The frame with its pose; unchanged where none is known.

    shift_ns: time of the frame's stamps minus time of the source's (a replay gives new stamps).
    """
    if poses is None:
        return frame
    pose = poses.at(frame.stamp_ns - shift_ns)
    if pose is None:
        poses.tell_unknown(frame.stamp_ns - shift_ns)
        return frame
    return frame.with_(pose=pose)


def with_poses(frames: Iterable[Frame], poses: Poses | None) -> Iterator[Frame]:
    """Frames, each with its pose where one is known."""
    return (posed(frame, poses) for frame in frames)
