"""How far the surroundings of each point of a map are from its plane.

>>> ground = np.stack([*np.meshgrid(np.arange(20), np.arange(20)), np.zeros((20, 20))], -1).reshape(-1, 3)
>>> up = np.full(400, 16, np.uint16)
>>> flat = MapPoints(0.02, (10 * ground).astype(np.int64), {"normal_a": up, "normal_b": up})
>>> bool(off_planes(flat).max() < 0.02)
True
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.maps.points import MapPoints

NEIGHBOURS: Final = 24
NEAR_M: Final = 0.6
FEWEST: Final = 4
"""A point with fewer neighbours counts as LONELY_M off."""
LONELY_M: Final = 0.2
"""Distances from a plane count as at most so much."""
_PART: Final = 1 << 16


def off_planes(points: MapPoints) -> npt.NDArray[np.float64]:
    """(N,) metres, root mean square of the distances of the neighbours of each point from its plane; 0 without normals
    or with fewer points than NEIGHBOURS."""
    import small_gicp

    normals = points.normals
    if normals is None or len(points) < NEIGHBOURS:
        return np.zeros(len(points))
    xyz = np.ascontiguousarray(points.xyz - points.xyz.mean(axis=0))
    tree, found = small_gicp.KdTree(xyz), np.empty(len(points))
    for begin in range(0, len(points), _PART):
        part = slice(begin, begin + _PART)
        near, squares = (np.asarray(each) for each in tree.batch_knn_search(xyz[part], NEIGHBOURS))
        across = np.einsum("nj,nkj->nk", normals[part], xyz[near] - xyz[part, None])
        counts = squares < NEAR_M**2
        number = counts.sum(axis=1)
        sums = (np.minimum(np.abs(across), LONELY_M) ** 2 * counts).sum(axis=1)
        found[part] = np.where(number < FEWEST, LONELY_M, np.sqrt(sums / np.maximum(number, 1)))
    return found
