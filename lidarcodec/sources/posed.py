"""Frames with the pose of the sensor at their first packet, and with its mounting."""

from __future__ import annotations

from bisect import bisect
from collections import OrderedDict
from collections.abc import Iterable, Iterator
from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.frame import Frame
from lidarcodec.mounting import Mounting
from lidarcodec.sources.poses import Poses

REMEMBERED: Final = 4096
"""Messages of a recording whose poses are known while it is read: a turn of many slabs has the pose of its first."""


class CarriedPoses:
    """The poses that the messages of a recording carry, while it is read: those of its newest frames.

    A source that turns such frames into packets would lose them. Not thread-safe.
    count: frames with a pose that were read
    """

    def __init__(self) -> None:
        self.count = 0
        self._known: OrderedDict[int, npt.NDArray[np.float64]] = OrderedDict()

    def taken(self, frames: Iterable[Frame]) -> Iterator[Frame]:
        """The frames, from the beginning of a recording. One is read ahead, so that a pose can lie between two."""
        self.count = 0
        before: Frame | None = None
        for frame in frames:
            if frame.pose is not None:
                self.count += 1
                self._known[frame.stamp_ns] = frame.pose
                self._known.move_to_end(frame.stamp_ns)  # a recording that is played in a loop comes again
                if len(self._known) > REMEMBERED:
                    self._known.popitem(last=False)
            if before is not None:
                yield before
            before = frame
        if before is not None:
            yield before

    def at(self, stamp_ns: int) -> npt.NDArray[np.float64] | None:
        """(4, 4) T_world_sensor of the frame with this stamp, or between the frames around it; None if unknown."""
        if (pose := self._known.get(stamp_ns)) is not None:
            return pose
        stamps = sorted(self._known)
        after = bisect(stamps, stamp_ns)
        around = stamps[max(after - 2, 0) : after + 2]
        if len(around) < 2:
            return None
        return Poses(np.array(around, np.int64), np.stack([self._known[stamp] for stamp in around])).at(stamp_ns)


def posed(frame: Frame, poses: Poses | CarriedPoses | None, shift_ns: int = 0, mount: Mounting | None = None) -> Frame:
    """The frame with its pose and its mounting; unchanged where neither is known.

    poses: of a file or a simulated drive; a warning says once where they lack one. Or those that its recording carried
    shift_ns: time of the frame's stamps minus time of the source's (a replay gives new stamps).
    """
    pose = None if poses is None else poses.at(frame.stamp_ns - shift_ns)
    if isinstance(poses, Poses) and pose is None:
        poses.tell_unknown(frame.stamp_ns - shift_ns)
    changes = {} if pose is None else {"pose": pose}
    if mount is not None:
        changes["mount"] = mount.T_vehicle_sensor
    return frame.with_(**changes) if changes else frame


def with_poses(
    frames: Iterable[Frame], poses: Poses | CarriedPoses | None, mount: Mounting | None = None
) -> Iterator[Frame]:
    """Frames, each with its pose where one is known, and with the mounting of the sensor."""
    return (posed(frame, poses, mount=mount) for frame in frames)
