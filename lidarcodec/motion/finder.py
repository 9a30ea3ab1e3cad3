"""The motion of the sensor in the last turn. The encoder gets it from poses, or by registration of ranges.

A frame of any length needs the motion of one turn, because the history has the ranges of a turn ago. The velocity
between two poses is assumed to be constant, and is scaled to the time of a turn. A frame of half a turn or more is
registered with the history (`find_motion` of the native core). A slab has too few returns to determine a motion. So
twice a turn the slabs of the last turn together are registered with the turn before. The slabs in between use the same
motion.

If registration fails, the motion is that of the poses. Without poses it is the last one found, for a second. After that
the sensor is assumed to stand still.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec.frame import Frame
from lidarcodec.motion.motion import ROTATION_UNIT, SHIFT_UNIT_M, STILL, Motion, is_rigid
from lidarcodec.motion.warp import RangeHistory, beam_rows, swept
from lidarcodec.sensor_model import SensorModel
from lidarcodec.units import AZIMUTH_TURN

Origin = Literal["poses", "found", "kept", "still"]

KEPT_TURNS: Final = 10
"""Number of turns, a second, for which the last motion is used if no new one is found."""
MIN_MATCHED_SHARE: Final = 0.3
"""Share of the points that must match the earlier surface."""
_HALF: Final = AZIMUTH_TURN // 2

_MAX_POSE_TURNS: Final = 10.0
"""Poses further apart than this many turns do not determine the motion of one turn."""
TURN_NS: Final = 100_000_000
"""Time of a turn until frames have shown the true one."""
_FASTEST_TURN_NS, _SLOWEST_TURN_NS = 40_000_000, 250_000_000


@dataclass(frozen=True)
class FoundMotion:
    """A motion and its origin.

    origin: `poses`; `found` by registration; `kept`: the last one found; `still`: nothing is known
    """

    motion: Motion
    origin: Origin


class _Seen(NamedTuple):
    """The columns of one frame, or of several consecutive frames."""

    ranges: npt.NDArray[np.uint16]
    azimuth: npt.NDArray[np.uint16]
    fired: npt.NDArray[np.bool_]
    sensor: SensorModel

    @classmethod
    def of(cls, frames: list[Frame]) -> _Seen:
        if len(frames) == 1:
            return cls(frames[0].range_u16, frames[0].azimuth, frames[0].fired, frames[0].sensor)
        ranges, azimuth, fired = ([frame.range_u16 for frame in frames], [frame.azimuth for frame in frames],
                                  [frame.fired for frame in frames])  # fmt: skip
        return cls(np.hstack(ranges), np.hstack(azimuth), np.hstack(fired), frames[-1].sensor)


class MotionFinder:
    """Gives the motion for each frame of a stream, in order. Call `next` before the history stores the frame.

    refine: True: a pose is the start of the registration; False: the pose is used directly, at no cost. KITTI's poses
    from GPS and inertial sensors need clearly more bits than registration.
    """

    def __init__(self, *, refine: bool = True) -> None:
        self._refine = refine
        self._last = STILL
        self._swept_since = AZIMUTH_TURN * KEPT_TURNS + 1  # azimuth steps since the last motion was found
        self._before: Frame | None = None
        self._swept_before = 0
        self._turn_ns = TURN_NS
        self._gathered: deque[tuple[Frame, int]] = deque()  # slabs of the last turn, and the azimuth steps of each
        self._unregistered = 0  # azimuth steps since slabs were registered
        self._older = RangeHistory()  # the history before the gathered slabs

    def next(self, frame: Frame, history: RangeHistory) -> FoundMotion:
        """The motion for coding this frame.

        history: earlier sent ranges; frame.range_u16: the original ranges
        """
        sweep = swept(frame.azimuth)
        posed = self._from_poses(frame)
        if posed is not None and not self._refine:
            result = posed
        elif sweep >= _HALF:
            self._gathered.clear()
            self._older.forget()
            result = self._registered(history, _Seen.of([frame]), posed)
        else:
            result = self._slab(frame, posed)
        if result.origin in ("poses", "found"):
            self._last, self._swept_since = result.motion, 0
        self._before, self._swept_before = frame, sweep
        self._swept_since += sweep
        return result

    def _from_poses(self, frame: Frame) -> FoundMotion | None:
        before = self._before
        if before is None or before.pose is None or frame.pose is None or frame.stamp_ns <= before.stamp_ns:
            return None
        if not (is_rigid(frame.pose) and is_rigid(before.pose)):  # coding the pose will raise an error
            return None
        passed_ns = frame.stamp_ns - before.stamp_ns
        gap = (_first(frame) - _last(before)) % AZIMUTH_TURN
        if frame.index == before.index + 1 and self._swept_before + gap > 0:
            turn_ns = passed_ns * AZIMUTH_TURN // (self._swept_before + gap)
            self._turn_ns = min(max(turn_ns, _FASTEST_TURN_NS), _SLOWEST_TURN_NS)
        # The history is a whole number of turns old in every direction: one turn, unless frames were skipped.
        turns = passed_ns / self._turn_ns
        moved = Motion.nearest(np.linalg.inv(frame.pose) @ before.pose) if turns <= _MAX_POSE_TURNS else None
        scaled = None if moved is None else moved.scaled(max(1, round(turns)) / turns)
        return None if scaled is None else FoundMotion(scaled, "poses")

    def _slab(self, frame: Frame, posed: FoundMotion | None) -> FoundMotion:
        """Twice a turn, register the slabs of the last turn with the turn before; otherwise give the last motion."""
        gap = 0 if self._before is None else (_first(frame) - _last(self._before)) % AZIMUTH_TURN
        advanced = swept(frame.azimuth) + gap
        self._gathered.append((frame, advanced))
        turned = sum(each for _, each in self._gathered)
        while turned > AZIMUTH_TURN:
            old, each = self._gathered.popleft()
            turned -= each
            self._older.remember(old.range_u16, old.azimuth, old.fired, old.sensor)
        self._unregistered += advanced
        if self._unregistered >= _HALF and turned > AZIMUTH_TURN * 3 // 4:
            self._unregistered = 0
            return self._registered(self._older, _Seen.of([slab for slab, _ in self._gathered]), posed)
        found_lately = self._swept_since <= AZIMUTH_TURN
        return self._kept("kept") if posed is None or found_lately else posed

    def _registered(self, history: RangeHistory, seen: _Seen, start: FoundMotion | None) -> FoundMotion:
        start = start or self._kept("kept")
        numbers, found, points, matched, *_ = history.native.find_motion(
            seen.ranges, seen.azimuth, seen.fired.view(np.uint8), beam_rows(seen.sensor), start.motion.numbers, False
        )
        if found and matched >= MIN_MATCHED_SHARE * points:
            motion = Motion.nearest(_matrix_of(numbers))
            if motion is not None:
                return FoundMotion(motion, "found")
        return start

    def _kept(self, origin: Origin) -> FoundMotion:
        if self._swept_since > AZIMUTH_TURN * KEPT_TURNS:
            return FoundMotion(STILL, "still")
        return FoundMotion(self._last, origin)


def _matrix_of(numbers: npt.NDArray[np.int32]) -> npt.NDArray[np.float64]:
    matrix = np.eye(4)
    matrix[:3, :3] = numbers[:9].reshape(3, 3) / ROTATION_UNIT
    matrix[:3, 3] = numbers[9:] * SHIFT_UNIT_M
    return matrix


def _first(frame: Frame) -> int:
    return int(frame.azimuth[0, 0]) if frame.width else 0


def _last(frame: Frame) -> int:
    return int(frame.azimuth[0, -1]) if frame.width else 0
