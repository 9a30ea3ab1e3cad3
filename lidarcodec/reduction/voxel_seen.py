"""`voxel-seen`: drops returns on surfaces that earlier scans did not see, and samples the rest like `voxel`.

The scans of 0.5 s and 0.9 s ago are compared with the frame. A return is dropped if it is nearer than 40 m, not on the
ground, and no return of these scans is near it. Its surface moves, or has just become visible. A moving surface
misleads a localiser, and a new surface is not needed. This is a causal form of PocoNet's observation count (how often a
point of the map is seen).

It removes moving cars and people, so it is only for localisation, never for human viewers or detectors.
"""

from __future__ import annotations

from collections import deque
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec import _native
from lidarcodec.frame import Frame
from lidarcodec.motion.warp import beam_rows
from lidarcodec.reduction.base import DEFAULT_SEED, Budget, Reducer, Reduction, with_kept
from lidarcodec.reduction.ground import ground_of
from lidarcodec.reduction.lots import drawn
from lidarcodec.reduction.odometry import Matrix, Odometry, deskewing
from lidarcodec.reduction.spread import Returns, Spread, returns_of

LAGS_NS: Final = (500_000_000, 900_000_000)
"""Ages of the earlier scans; one of them must have seen a return."""
_SLACK_NS: Final = 200_000_000
"""A scan may be this much younger or older, if frames were skipped."""
_KEPT_NS: Final = LAGS_NS[-1] + _SLACK_NS
_MOST_SCANS: Final = 4096


class _Scan(NamedTuple):
    stamp_ns: int
    T_world_sensor: Matrix
    points: npt.NDArray[np.float32]


class VoxelSeen(Reducer):
    """Voxel sampling of returns that were seen before; others are kept only if the budget is large enough."""

    def __init__(self, budget: Budget, argument: str | None = None, seed: int = DEFAULT_SEED) -> None:
        super().__init__(budget, argument, seed)
        self._spread, self._odometry = Spread(seed), Odometry()
        self._scans: deque[_Scan] = deque(maxlen=_MOST_SCANS)
        self._kind, self._dropped, self._looked = "unknown", 0, False

    def reset(self) -> None:
        """Forget all frames."""
        self._spread.reset()
        self._odometry.reset()
        self._scans.clear()
        self._kind, self._dropped, self._looked = "unknown", 0, False

    def reduce(self, frame: Frame) -> Frame:
        """The frame with exactly as many returns as the budget allows."""
        returns = returns_of(frame)
        unseen = self._unseen(frame, returns)
        count = self.budget.of(len(returns.cells))
        if count == len(returns.cells):
            return frame
        seen = returns.only(~unseen)
        chosen = self._spread.choose(seen, count, frame)
        if len(chosen) < count:
            rest = drawn(returns.cells[unseen], count - len(chosen), self.seed, frame.index)
            chosen = np.concatenate([chosen, rest])
        return with_kept(frame, chosen)

    def report(self) -> dict[str, Any]:
        """`cell_m` as in `voxel`; `odometry`: `poses`, `found` (by registration) or `unknown`; `seen_before`: whether
        there were scans of these ages, otherwise it chose like `voxel`; `unseen`: returns of the last frame that no
        earlier scan saw."""
        return {
            "cell_m": round(self._spread.side_m, 3),
            "odometry": self._kind,
            "seen_before": self._looked,
            "unseen": self._dropped,
        }

    def _unseen(self, frame: Frame, returns: Returns) -> npt.NDArray[np.bool_]:
        """(N,) bool, returns on surfaces that were not seen before; none if this is unknown."""
        place = self._odometry.next(frame)
        self._kind = place.kind
        if not place.sure:
            self._scans.clear()
        while self._scans and frame.stamp_ns - self._scans[0].stamp_ns > _KEPT_NS:
            self._scans.popleft()
        columns = returns.cells % max(frame.width, 1)
        points = _native.deskewed(returns.xyz, columns, deskewing(frame, place.per_turn))
        past = self._at_lags(frame.stamp_ns, place.turn_ns)
        self._looked = bool(past)
        found = np.zeros(len(returns.cells), np.uint8)
        if past:
            ground = _ground(frame, returns, points)
            here = np.linalg.inv(place.T_world_sensor)
            where = [(here @ scan.T_world_sensor)[:3].astype(np.float32).ravel() for scan in past]
            found = _native.unseen(points, ground, [(scan.points, at) for scan, at in zip(past, where, strict=True)])
        self._dropped = int(np.count_nonzero(found))
        self._scans.append(_Scan(frame.stamp_ns, place.T_world_sensor, points))
        return found.view(np.bool_)

    def _at_lags(self, now_ns: int, turn_ns: int) -> list[_Scan]:
        """The scans of these ages: the turn around each age, or the nearest scan; empty if one is missing."""
        chosen: list[_Scan] = []
        for lag_ns in LAGS_NS:
            off = [abs(now_ns - lag_ns - scan.stamp_ns) for scan in self._scans]
            within = [scan for scan, by in zip(self._scans, off, strict=True) if 2 * by < turn_ns]
            if not within and off and min(off) <= _SLACK_NS:
                within = [self._scans[off.index(min(off))]]
            if not within:
                return []
            chosen += within
        return chosen


def _ground(frame: Frame, returns: Returns, points: npt.NDArray[np.float32]) -> npt.NDArray[np.uint8]:
    """(N,) uint8, 1 for returns on the ground. points: (N, 3), deskewed"""
    if not frame.sensor.is_hdl64e:
        return ground_of(points)
    rows = beam_rows(frame.sensor)
    return _native.ground_of(points, returns.cells, frame.azimuth, frame.fired.view(np.uint8), rows)


REDUCTION = Reduction(
    VoxelSeen,
    note="removes what moves, such as cars and people: for localisation only, not for people who watch",
)
