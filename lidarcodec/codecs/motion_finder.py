"""The encoder's idea of how the sensor moved in the last turn: from poses where frames have them, else from ranges.

The motion that a frame needs is that of one turn, whatever the frame's length: in every direction the history holds
what was seen a turn ago. Between two poses the speed is taken for even, and carried to the time of a turn. Without
poses a frame of half a turn or more is registered with the history (`find_motion` of the native core, 6 ms); shorter
ones, slabs, do not hold a motion firmly, so they are gathered, registered once a turn, and go on with the motion found.

A motion that could not be found is the last one that was, for a second; then the sensor is taken to stand.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from lidarcodec.codecs.motion import STILL, Motion
from lidarcodec.codecs.warp import RangeHistory, beam_rows
from lidarcodec.frame import Frame
from lidarcodec.units import AZIMUTH_TURN

Origin = Literal["poses", "found", "kept", "still"]

KEPT_TURNS: Final = 10
"""Turns for which a motion holds when no new one is found: a second."""
LEAST_MATCHED: Final = 0.3
"""Share of the points tried that must lie on the surface seen before."""
_HALF: Final = AZIMUTH_TURN // 2
_MOST_POSE_TURNS: Final = 10.0
"""Poses further apart than this many turns say too little about each."""
TURN_NS: Final = 100_000_000
"""Time of a turn until frames have shown it."""
_FASTEST_TURN_NS, _SLOWEST_TURN_NS = 40_000_000, 250_000_000


@dataclass(frozen=True)
class FoundMotion:
    """A motion, where it is from, and how well it fits.

    origin: `poses`, `found`: registered; `kept`: not found, the last one; `still`: nothing is known
    points, matched: tried, and of them on the surface seen before; median_m: their median distance from it
    """

    motion: Motion
    origin: Origin
    points: int = 0
    matched: int = 0
    median_m: float = 0.0


class MotionFinder:
    """Gives the motion for each frame of a stream, in order. Call `next` before the history remembers the frame."""

    def __init__(self) -> None:
        self._last = STILL
        self._swept_since = AZIMUTH_TURN * KEPT_TURNS + 1  # azimuth steps since the last motion was found
        self._before: Frame | None = None
        self._swept_before = 0
        self._turn_ns = TURN_NS
        self._gathered: list[Frame] = []
        self._gathered_sweep = 0
        self._older = RangeHistory()  # what was seen before the frames that are gathered
        self._origin: Origin = "still"

    def next(self, frame: Frame, history: RangeHistory) -> FoundMotion:
        """The motion to code this frame with.

        history: what was sent before; frame.range: the original ranges
        """
        swept = _sweep(frame)
        result = self._from_poses(frame)
        if result is None:
            result = self._whole(frame, history) if swept >= _HALF else self._slab(frame, swept)
        if result.origin in ("poses", "found"):
            self._last, self._swept_since = result.motion, 0
        self._before, self._swept_before = frame, swept
        self._swept_since += swept
        return result

    def _from_poses(self, frame: Frame) -> FoundMotion | None:
        before = self._before
        if before is None or before.pose is None or frame.pose is None or frame.stamp_ns <= before.stamp_ns:
            return None
        passed_ns = frame.stamp_ns - before.stamp_ns
        gap = (_first(frame) - _last(before)) % AZIMUTH_TURN
        if frame.index == before.index + 1 and self._swept_before + gap > 0:
            turn_ns = passed_ns * AZIMUTH_TURN // (self._swept_before + gap)
            self._turn_ns = min(max(turn_ns, _FASTEST_TURN_NS), _SLOWEST_TURN_NS)
        # in every direction the history is a whole number of turns old: one, unless frames were left out
        turns = passed_ns / self._turn_ns
        moved = Motion.nearest(np.linalg.inv(frame.pose) @ before.pose) if turns <= _MOST_POSE_TURNS else None
        scaled = None if moved is None else moved.scaled(max(1, round(turns)) / turns)
        return None if scaled is None else FoundMotion(scaled, "poses")

    def _whole(self, frame: Frame, history: RangeHistory) -> FoundMotion:
        self._gathered, self._gathered_sweep = [], 0
        return self._registered(history, frame.range, frame.azimuth, frame.fired, frame)

    def _slab(self, frame: Frame, swept: int) -> FoundMotion:
        """Registers the slabs of a turn when they are complete; until then the last motion goes on."""
        self._gathered.append(frame)
        self._gathered_sweep += swept
        if self._gathered_sweep < AZIMUTH_TURN:
            return self._kept("found" if self._origin == "found" else "kept")
        slabs, self._gathered, self._gathered_sweep = self._gathered, [], 0
        ranges, azimuth, fired = (
            np.concatenate([getattr(slab, name) for slab in slabs], axis=1) for name in ("range", "azimuth", "fired")
        )
        result = self._registered(self._older, ranges, azimuth, fired, frame)
        self._older.remember(ranges, azimuth, fired, frame.sensor)
        self._origin = result.origin
        return result

    def _registered(
        self,
        history: RangeHistory,
        ranges: npt.NDArray[np.uint16],
        azimuth: npt.NDArray[np.uint16],
        fired: npt.NDArray[np.bool_],
        frame: Frame,
    ) -> FoundMotion:
        start = self._last if self._swept_since <= AZIMUTH_TURN * KEPT_TURNS else STILL
        numbers, found, points, matched, _, median_m = history.native.find_motion(
            ranges, azimuth, fired.view(np.uint8), beam_rows(frame.sensor), start.numbers
        )
        if found and matched >= LEAST_MATCHED * points:
            motion = Motion.nearest(_matrix_of(numbers))
            if motion is not None:
                return FoundMotion(motion, "found", points, matched, median_m)
        return self._kept("kept")

    def _kept(self, origin: Origin) -> FoundMotion:
        if self._swept_since > AZIMUTH_TURN * KEPT_TURNS:
            return FoundMotion(STILL, "still")
        return FoundMotion(self._last, origin)


def _matrix_of(numbers: npt.NDArray[np.int32]) -> npt.NDArray[np.float64]:
    matrix = np.eye(4)
    matrix[:3, :3] = numbers[:9].reshape(3, 3) / (1 << 30)
    matrix[:3, 3] = numbers[9:] * 0.0000625
    return matrix


def _sweep(frame: Frame) -> int:
    """Azimuth steps over which a frame turned."""
    return int((np.diff(frame.azimuth[0].astype(np.int64)) % AZIMUTH_TURN).sum()) if frame.width else 0


def _first(frame: Frame) -> int:
    return int(frame.azimuth[0, 0]) if frame.width else 0


def _last(frame: Frame) -> int:
    return int(frame.azimuth[0, -1]) if frame.width else 0
