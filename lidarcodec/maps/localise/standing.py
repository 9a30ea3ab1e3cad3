"""What stands above the ground: in which town a scan was taken. The ground fits in any town.

>>> ground = np.stack([*np.meshgrid(np.arange(20.0), np.arange(20.0)), np.zeros((20, 20))], -1).reshape(-1, 3)
>>> above_ground(np.vstack([ground, [[5.0, 5.0, 2.0]]])).tolist().index(True)
400
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.evaluation.rigid import Matrix, moved
from lidarcodec.maps.world import FEWEST, Fit, MapWorld

GROUND_M: Final = 6.0
"""Width of the cells whose lowest point is ground."""
ABOVE_M: Final = 0.7
STANDING: Final = 0.25
"""Least share of a scan's returns above the ground that lie in the map."""
ON_UPRIGHT: Final = 0.15
"""The same on walls, poles and trunks: banks and kerbs fit elsewhere, too."""
MUCH: Final = 0.125
"""If a smaller share of the returns is above the ground, they are not checked: on an open road most are of traffic."""


def above_ground(points: Matrix) -> npt.NDArray[np.bool_]:
    """(N,) whether points (N, 3) are clearly above the lowest one around."""
    cells = np.floor(points[:, :2] / GROUND_M).astype(np.int64)
    cells -= cells.min(axis=0) - 1
    shape = cells.max(axis=0) + 2
    lowest = np.full(shape, np.inf)
    np.minimum.at(lowest, (cells[:, 0], cells[:, 1]), points[:, 2])
    around = lowest.copy()
    for x in (-1, 0, 1):
        for y in (-1, 0, 1):
            around = np.minimum(around, np.roll(lowest, (x, y), (0, 1)))
    above: npt.NDArray[np.bool_] = points[:, 2] > around[cells[:, 0], cells[:, 1]] + ABOVE_M
    return above


def standing_share(world: MapWorld, cloud: Matrix, pose: Matrix) -> float:
    """Share of the returns above the ground that lie in the map, of a cloud (N, 3) at a pose (4, 4); 0 without any."""
    found = world.fit(cloud[above_ground(moved(pose, cloud))], pose, ())
    return found.share * found.partners


def is_here(world: MapWorld, cloud: Matrix, fit: Fit) -> bool:
    """Whether what stands around a registered scan stands in the map, too; also where too little stands to say so."""
    if len(cloud) < FEWEST:
        return False
    standing = cloud[above_ground(moved(fit.pose, cloud))]
    if len(standing) < max(FEWEST, MUCH * len(cloud)):
        return True
    found = world.fit(standing, fit.pose, ())
    return found.share * found.partners >= STANDING and world.upright(standing, fit.pose) >= ON_UPRIGHT
