"""`greedy`: points in proportion to how often scans hit them, in each small cube and each direction.

With at most K points it maximises, over the numbers n_g of points of each group g, a cube and a direction,

    sum over groups g of w_g log n_g,   w_g = h_g * (all / that of its direction)^(1/3)

where h_g adds up, over the points of g, by how many scans more than three each was hit. What few scans hit is often a
car that drove beside the sensor, which is elsewhere in the next scan.

A direction is that of the normal: up, or one of four ways along the ground. So scans of all places find partners where
they have returns, and where few points hold a scan in one direction, as along a straight road, more of these are kept.
The sum is monotone and submodular, and each step of greedy takes from the group with the largest w_g / n_g. Because the
groups are apart from each other, that ends at n_g in proportion to w_g, at most all points of g, which is found at
once. In each group the points that most scans hit are kept: their places are known best.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.maps.points import MapPoints
from lidarcodec.maps.select.result import Selection, check_seen

CUBE_M: Final = 2.0
DIRECTIONS: Final = 5
UP: Final = 0.8
"""Least height of a normal that faces up."""
MOST_COUNT: Final = 30
"""A car that stands at a crossing hits the same points again and again; that makes them no better."""
SELDOM: Final = 3
"""Scans that hit a point without making it worth anything."""
LITTLE: Final = 1e-3
"""What such a point is worth, so that it is kept if nothing else is left."""
SCARCE: Final = 1 / 3
_HALVINGS: Final = 60
Ints = npt.NDArray[np.int64]
Floats = npt.NDArray[np.float64]


def greedy(points: MapPoints, count: int, seed: int) -> Selection:
    """The points of the largest sum. Raises SettingsError for a map that does not say how often points were seen."""
    del seed
    check_seen(points, "greedy")
    group, direction = groups_of(points)
    hits = points.columns["count"].astype(np.int64)
    worth = worth_of(points)
    weights = np.bincount(group, worth).astype(np.float64)
    totals = np.bincount(direction, weights, DIRECTIONS)
    weights *= (weights.sum() / np.maximum(totals[direction], 1e-9)) ** SCARCE
    return Selection(points.taken(foremost(group, weights, -hits, count)), {})


def worth_of(points: MapPoints) -> Floats:
    """(N,) by how many scans more than SELDOM each point was hit."""
    hits = points.columns["count"].astype(np.int64)
    found: Floats = np.maximum(np.minimum(hits, MOST_COUNT) - SELDOM, LITTLE)
    return found


def foremost(group: Ints, weights: Floats, key: Ints | Floats, count: int) -> Ints:
    """Places of at most `count` points: of each group a number in proportion to its weight, with the least keys."""
    size = np.bincount(group)
    wanted = allotted(weights, size, min(count, len(group)))
    order = np.lexsort((key, group))
    rank = np.arange(len(order)) - np.repeat(np.cumsum(size) - size, size)
    found: Ints = np.sort(order[rank < np.repeat(wanted, size)])
    return found


def allotted(weights: Floats, size: Ints, count: int) -> Ints:
    """Whole numbers in proportion to the weights (G,), at most `size` (G,), with a sum of `count`. What rounding leaves
    goes to the next group, so that groups side by side get what one of them alone would not."""
    low, high = 0.0, count / max(float(weights.min()), 1e-9)
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        low, high = (low, middle) if np.minimum(size, middle * weights).sum() > count else (middle, high)
    sums = np.floor(np.cumsum(np.minimum(size, low * weights)) + 0.5).astype(np.int64)
    found: Ints = np.minimum(np.diff(np.minimum(sums, count), prepend=0), size)
    return found


def _facing(points: MapPoints) -> Ints:
    """(N,) direction of each point, 0 to 4; all 0 without normals."""
    normals = points.normals
    if normals is None:
        return np.zeros(len(points), np.int64)
    sector = np.floor(np.arctan2(normals[:, 1], normals[:, 0]) / (np.pi / 4) + 0.5).astype(np.int64) % 4
    return np.where(normals[:, 2] > UP, 0, 1 + sector)


def groups_of(points: MapPoints) -> tuple[Ints, Ints]:
    """Group of each point (N,), and direction of each group (G,)."""
    facing = _facing(points)
    cells = np.floor(points.xyz / CUBE_M).astype(np.int64)
    cells -= cells.min(axis=0, initial=0)
    spans = cells.max(axis=0, initial=0) + 1
    keys, group = np.unique(
        ((cells[:, 2] * spans[1] + cells[:, 1]) * spans[0] + cells[:, 0]) * DIRECTIONS + facing, return_inverse=True
    )
    return group.reshape(-1).astype(np.int64), (keys % DIRECTIONS).astype(np.int64)
