"""The pose of the sensor at the start of each frame: from the poses of frames, or by registration with earlier frames.

Chained motions drift by one or two percent. That is enough for a reducer, which uses the last second, but not for other
purposes. With poses it costs nothing, without poses 7 ms a turn.
"""

from __future__ import annotations

from typing import Final, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec.frame import Frame
from lidarcodec.motion.finder import TURN_NS, MotionFinder
from lidarcodec.motion.motion import Motion
from lidarcodec.motion.warp import RangeHistory
from lidarcodec.reduction.stand_in import StandIn
from lidarcodec.units import AZIMUTH_TURN

LONGEST_GAP_NS: Final = 1_000_000_000
"""Frames that are further apart are not related to each other."""
CARRIED_NS: Final = 300_000_000
"""How long the last motion is used if no new one is found, for example in the incomplete turn at the end of a
recording. If the car brakes hard, the error is a decimetre."""
_MOST_SPEED_M_S: Final = 150.0
_FASTEST_TURN_NS, _SLOWEST_TURN_NS = 40_000_000, 250_000_000

Matrix = npt.NDArray[np.float64]
Kind = Literal["poses", "found", "carried", "unknown"]


class Place(NamedTuple):
    """The pose of the sensor at the stamp of a frame, and its motion.

    T_world_sensor: (4, 4); the world frame is the sensor's frame at the last place that is not `sure`
    per_turn: (4, 4), T_now_turn: from the sensor's frame a turn later to its present frame
    turn_ns:  time of a turn
    sure:     whether the place is known relative to the previous one
    """

    T_world_sensor: Matrix
    per_turn: Matrix
    turn_ns: int
    kind: Kind

    @property
    def sure(self) -> bool:
        """Whether the place is known relative to that of the previous frame."""
        return self.kind != "unknown"


class Odometry:
    """Gets the frames of a stream in order. With poses it costs nothing, without poses 7 ms a turn."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget all frames."""
        self._finder, self._history = MotionFinder(refine=False), RangeHistory()
        self._stand_in = StandIn()
        self._before: Frame | None = None
        self._turn_ns = TURN_NS
        self._here: Matrix = np.eye(4)
        self._remembers = False
        self._found_ns = 0

    def next(self, frame: Frame) -> Place:
        """The place of the sensor at the start of this frame."""
        before = self._before
        passed_ns = 0 if before is None else frame.stamp_ns - before.stamp_ns
        if before is None or not 0 < passed_ns <= LONGEST_GAP_NS or frame.sensor.hash != before.sensor.hash:
            self.reset()
            before, passed_ns = None, 0
        if before is not None and frame.index == before.index + 1:
            turned = _swept(before) + _gap(before, frame)
            self._turn_ns = min(max(passed_ns * AZIMUTH_TURN // max(turned, 1), _FASTEST_TURN_NS), _SLOWEST_TURN_NS)
        place = self._by_poses(frame, before, passed_ns)
        if place is None:
            place = self._by_registration(frame, before, passed_ns)
        else:
            self._remembers = False
        self._before, self._here = frame, place.T_world_sensor
        return place

    def _by_poses(self, frame: Frame, before: Frame | None, passed_ns: int) -> Place | None:
        pose = frame.pose
        if pose is None or not _rigid(pose):
            return None
        if before is None or before.pose is None or not _rigid(before.pose):
            return Place(pose, np.eye(4), self._turn_ns, "unknown")
        moved = np.linalg.inv(before.pose) @ pose
        if np.linalg.norm(moved[:3, 3]) > _MOST_SPEED_M_S * passed_ns * 1e-9:
            return Place(pose, np.eye(4), self._turn_ns, "unknown")
        motion = Motion.nearest(moved)
        per_turn = None if motion is None else motion.scaled(self._turn_ns / passed_ns)
        return Place(pose, np.eye(4) if per_turn is None else per_turn.matrix, self._turn_ns, "poses")

    def _by_registration(self, frame: Frame, before: Frame | None, passed_ns: int) -> Place:
        if not self._remembers:  # earlier frames had poses and are not in the history
            self._finder, self._history = MotionFinder(refine=False), RangeHistory()
            before = None
        bare = frame if frame.pose is None else frame.with_(pose=None)
        seen = bare if frame.sensor.is_hdl64e else self._stand_in.of(bare)
        if seen is None:  # nobody knows where its beams look
            return Place(np.eye(4), np.eye(4), self._turn_ns, "unknown")
        found = self._finder.next(seen, self._history)
        self._history.remember(seen.range_u16, seen.azimuth, seen.fired, seen.sensor)
        self._remembers = True
        if found.origin == "found":
            self._found_ns = frame.stamp_ns
        known = found.origin == "found" or (found.origin == "kept" and frame.stamp_ns - self._found_ns <= CARRIED_NS)
        if before is None or not known:
            return Place(np.eye(4), np.eye(4), self._turn_ns, "unknown")
        turns = passed_ns / self._turn_ns
        whole = max(1, round(turns))  # the history is a whole number of turns old in every direction
        per_turn = found.motion.scaled(-1 / whole)
        step = found.motion.scaled(-turns / whole)
        if per_turn is None or step is None:
            return Place(np.eye(4), np.eye(4), self._turn_ns, "unknown")
        kind: Kind = "found" if found.origin == "found" else "carried"
        return Place(self._here @ step.matrix, per_turn.matrix, self._turn_ns, kind)


def _rigid(pose: Matrix) -> bool:
    """Whether a pose is a rotation and a shift, up to rounding."""
    if not (np.isfinite(pose).all() and np.abs(pose).max() < 1e9):
        return False
    turn = pose[:3, :3]
    return bool(np.allclose(turn @ turn.T, np.eye(3), atol=1e-3) and np.linalg.det(turn) > 0 and pose[3, 3] == 1)


def _swept(frame: Frame) -> int:
    """Azimuth steps of a frame."""
    return int((np.diff(frame.azimuth[0].astype(np.int64)) % AZIMUTH_TURN).sum()) if frame.width else 0


def _gap(before: Frame, frame: Frame) -> int:
    """Azimuth steps from the last column of a frame to the first column of the next."""
    if not (before.width and frame.width):
        return 0
    return (int(frame.azimuth[0, 0]) - int(before.azimuth[0, -1])) % AZIMUTH_TURN


def deskewing(frame: Frame, per_turn: Matrix) -> npt.NDArray[np.float32]:
    """(W, 12) float32, the transform of each column's points to the sensor's frame at the start of the frame.

    A transform is a rotation row by row, each row with its component of the shift. The velocity is constant.
    per_turn: (4, 4), T_now_turn
    """
    azimuth = frame.azimuth[0].astype(np.int64)
    swept = np.concatenate([[0], np.cumsum(np.diff(azimuth) % AZIMUTH_TURN)])[: frame.width]
    part = swept / AZIMUTH_TURN
    turn, shift = per_turn[:3, :3], per_turn[:3, 3]
    axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2
    moved = np.empty((frame.width, 3, 4), np.float32)
    moved[:, :, :3] = np.eye(3)
    x, y, z = (part * value for value in axis)  # rotations within a turn are small, so linear scaling is enough
    moved[:, 0, 1], moved[:, 0, 2], moved[:, 1, 2] = -z, y, -x
    moved[:, 1, 0], moved[:, 2, 0], moved[:, 2, 1] = z, -y, x
    moved[:, :, 3] = part[:, None] * shift
    return moved.reshape(frame.width, 12)
