"""How many scans of a drive saw a place: the paper's observation counts, computed from the whole drive.

A place is the mean of a 0.1 m cell over the scans of the map. A scan sees it if it has a return within 0.1 m, and
counts once. A return gets the count of its nearest place within 0.5 m, or 0 if there is none. A standing car sees the
same places repeatedly, which is no new information. So a scan counts only after 0.5 m of travel.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from lidarcodec import _native
from lidarcodec.evaluation.localisation.drive import Drive
from lidarcodec.evaluation.localisation.maps import whole_map
from lidarcodec.evaluation.localisation.reference import Reference
from lidarcodec.evaluation.rigid import Matrix, moved

CELL_M: Final = 0.1
INDEX_CELL_M: Final = 0.2
SEEN_WITHIN_M: Final = 0.1
ASSIGNED_WITHIN_M: Final = 0.5
TRAVEL_M: Final = 0.5
Tick = Callable[[], None]


def place_counts(
    drive: Drive, reference: Reference, mapped: Iterable[int], tick: Tick = lambda: None
) -> tuple[Matrix, npt.NDArray[np.int32]]:
    """Places (M, 3) in the world, and the number of mapped scans that saw each place (M,). About 0.1 s a scan."""
    places = whole_map(drive, reference, mapped, CELL_M)
    index, counts = _index(places), np.zeros(len(places), np.int32)
    for at in travelled(reference.poses):
        world = moved(reference.poses[at], drive.cloud(at, reference.velocities[at]))
        counts += index.near(np.ascontiguousarray(world), SEEN_WITHIN_M)
        tick()
    return places, counts


def travelled(poses: Matrix) -> list[int]:
    """Indices of scans at least 0.5 m from the previously selected scan."""
    taken = [0]
    for at in range(1, len(poses)):
        if np.linalg.norm(poses[at, :3, 3] - poses[taken[-1], :3, 3]) >= TRAVEL_M:
            taken.append(at)
    return taken


class Counted:
    """Looks up the counts of returns. places: (M, 3) in the world; counts: (M,)"""

    def __init__(self, places: Matrix, counts: npt.NDArray[np.int32]) -> None:
        self._index, self._counts = _index(places), np.append(counts, np.int32(0))  # the last: no place is near

    def of(self, points: Matrix) -> npt.NDArray[np.int32]:
        """(N,) the count of the nearest place of each point (N, 3) in the world."""
        found: npt.NDArray[np.int32] = self._counts[
            self._index.nearest(np.ascontiguousarray(points), ASSIGNED_WITHIN_M)
        ]
        return found


def _index(places: Matrix) -> Any:
    return _native.VoxelIndex(np.ascontiguousarray(places), INDEX_CELL_M)
