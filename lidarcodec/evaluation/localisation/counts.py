"""How many scans of a drive saw a place again: the paper's observation counts, with the whole drive at hand.

A place is the mean of a 0.1 m cell over every fifth scan; a scan sees it when it has a return within 0.1 m, and counts
once. A return takes the count of the place nearest to it within 0.5 m, 0 where there is none. A car that stands sees
the same again and again and learns nothing by it: scans count from 0.5 m of travel on.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.evaluation.geometry import Cloud
from lidarcodec.evaluation.localisation.drive import Drive
from lidarcodec.evaluation.localisation.maps import whole_map
from lidarcodec.evaluation.localisation.reference import Reference
from lidarcodec.evaluation.rigid import Matrix, moved
from lidarcodec.evaluation.trajectory import FARTHEST_M

CELL_M: Final = 0.1
SEEN_WITHIN_M: Final = 0.1
ASSIGNED_WITHIN_M: Final = 0.5
TRAVEL_M: Final = 0.5
Tick = Callable[[], None]


def place_counts(drive: Drive, reference: Reference, tick: Tick = lambda: None) -> tuple[Matrix, npt.NDArray[np.int32]]:
    """Places (M, 3) in the world and how many scans saw each, (M,). About 0.5 s a scan."""
    places = whole_map(drive, reference, CELL_M)
    counts = np.zeros(len(places), np.int32)
    for at in travelled(reference.poses):
        pose = reference.poses[at]
        near = np.flatnonzero(np.linalg.norm(places[:, :2] - pose[:2, 3], axis=1) < FARTHEST_M)
        seen = Cloud(moved(pose, drive.cloud(at, reference.velocities[at]))).distances(places[near]) < SEEN_WITHIN_M
        counts[near[seen]] += 1
        tick()
    return places, counts


def travelled(poses: Matrix) -> list[int]:
    """The scans that lie at least 0.5 m from the one before that was taken."""
    taken = [0]
    for at in range(1, len(poses)):
        if np.linalg.norm(poses[at, :3, 3] - poses[taken[-1], :3, 3]) >= TRAVEL_M:
            taken.append(at)
    return taken


class Counted:
    """Looks up the counts of returns. places: (M, 3) in the world; counts: (M,)"""

    def __init__(self, places: Matrix, counts: npt.NDArray[np.int32]) -> None:
        self._tree, self._counts = Cloud(places), counts

    def of(self, points: Matrix) -> npt.NDArray[np.int32]:
        """(N,) the count of the nearest place of each point (N, 3) in the world."""
        near = self._tree.nearest(points)
        found: npt.NDArray[np.int32] = np.where(
            np.linalg.norm(self._tree.points[near] - points, axis=1) <= ASSIGNED_WITHIN_M, self._counts[near], 0
        )
        return found
