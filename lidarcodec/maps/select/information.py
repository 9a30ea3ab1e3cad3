"""`information`: points by what they tell of the pose of a scan, in each small cube and each direction.

The information about a pose is the 6 x 6 matrix of the normal equations of a registration, point to plane:

    I_p = sum over groups g that place p sees of r_g M_gp,   M_gp = mean of J n n' J' over the points of g

where J n is the slope of the distance to a plane with normal n, and r_g adds up, over the points of g, the hits beyond
three divided by the square of how far their surroundings are from their planes, GRAIN_M added. The hits are shared out
evenly among the places that see the group. With at most K points each group gets a number in proportion to

    sum over p of r_g trace(M_gp I_p^-1),

its leverage, which is the slope of sum_p log det I_p. It adds up to six at each place, so that no place gets less than
another, and no direction of motion or rotation less than another. Zhao and Vela choose features for visual SLAM by the
determinant ("Good feature matching: toward accurate, robust VO/VSLAM with low latency", 2020). Cubes and directions are
those of `greedy`.

Of a group that faces along the path, points are kept that lie in a plane with their surroundings: there are few such
things on a road, and they alone say how far along it a scan is. Of all others, points that most scans hit: flat ones
hold a scan where it is, so that one that starts metres behind does not come all the way (research/notes).
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import SettingsError
from lidarcodec.evaluation.rigid import Matrix
from lidarcodec.maps.points import MapPoints
from lidarcodec.maps.select.flatness import off_planes
from lidarcodec.maps.select.greedy import Floats, Ints, foremost, groups_of, worth_of
from lidarcodec.maps.select.result import Selection, check_seen

GRAIN_M: Final = 0.02
SELDOM_M: Final = 0.1
"""A point that few scans hit counts as further from its plane: by this, divided by the hits beyond three."""
ALONG: Final = 0.5
"""Least mean |cosine| between normals and the path of a group that faces along it."""
PLACES: Final = 2
"""Every second place of the path is looked at, which is about one in two metres."""
LEVER_M: Final = 10.0
_LEAST: Final = 1e-6
_FEWEST: Final = 6
"""Fewer groups than this do not hold a pose."""


def information(points: MapPoints, count: int, seed: int) -> Selection:
    """The points that tell most. Raises SettingsError for a map without normals, or that does not say how often points
    were seen."""
    del seed
    check_seen(points, "information")
    normals = points.normals
    if normals is None:
        raise SettingsError("--by information needs a map with normals", "by")
    group, _ = groups_of(points)
    worth, off = worth_of(points), off_planes(points)
    weights = np.maximum(_leverage(points, normals, group, worth / (off + GRAIN_M) ** 2), _LEAST)
    flat, hits = off + SELDOM_M / np.maximum(worth, 0.5), points.columns["count"].astype(np.float64)
    key = np.where(_along(points, normals, group)[group], flat, -hits)
    return Selection(points.taken(foremost(group, weights, key, count)), {})


def _along(points: MapPoints, normals: Matrix, group: Ints) -> npt.NDArray[np.bool_]:
    """(G,) whether a group faces along the path where that is nearest."""
    import small_gicp

    size, middle = np.bincount(group), points.path.mean(axis=0, dtype=np.float64)
    path = np.ascontiguousarray(points.path - middle)
    if len(path) < 2:
        return np.zeros(len(size), np.bool_)
    ways = np.gradient(path, axis=0)
    ways /= np.maximum(np.linalg.norm(ways, axis=1, keepdims=True), _LEAST)
    groups = np.stack([np.bincount(group, values) / size for values in (points.xyz - middle).T], axis=1)
    places = np.asarray(small_gicp.KdTree(path).batch_knn_search(groups, 1)[0])[:, 0].astype(np.int64)
    facing = np.abs(np.einsum("ij,ij->i", normals, ways[places][group]))
    found: npt.NDArray[np.bool_] = np.bincount(group, facing) / size > ALONG
    return found


def _leverage(points: MapPoints, normals: Matrix, group: Ints, worth: Floats) -> Floats:
    """(G,) leverage of each group, summed over the places that see it."""
    sums = np.bincount(group, worth)
    number = len(sums)

    def mean(values: Floats) -> Floats:
        found: Floats = np.bincount(group, worth * values, number) / sums
        return found

    middle = np.stack([mean(values) for values in points.xyz.T], axis=1)
    across = np.stack([mean(a * b) for a in normals.T for b in normals.T], axis=1).reshape(number, 3, 3)
    first, last = np.full(number, len(points.path)), np.zeros(number, np.int64)
    np.minimum.at(first, group, points.columns["first"].astype(np.int64))
    np.maximum.at(last, group, points.columns["last"].astype(np.int64))
    shared, found = sums / (last - first + 1), np.zeros(number)
    for place in range(0, len(points.path), PLACES):
        seen = np.flatnonzero((first <= place) & (last >= place))
        if len(seen) < _FEWEST:
            continue
        slopes = _slopes(middle[seen] - points.path[place])
        each = np.einsum("sij,sjk,slk->sil", slopes, across[seen], slopes, optimize=True)
        whole = np.einsum("s,sij->ij", shared[seen], each)
        whole += _LEAST * np.trace(whole) * np.eye(6)
        found[seen] += shared[seen] * np.einsum("sij,ji->s", each, np.linalg.inv(whole))
    return found


def _slopes(off: Matrix) -> Matrix:
    """(S, 6, 3) J of points at `off` (S, 3) from the sensor: motion, and rotation over a lever of LEVER_M."""
    x, y, z = off.T / LEVER_M
    none = np.zeros(len(off))
    turns = np.stack([none, -z, y, z, none, -x, -y, x, none], axis=1).reshape(-1, 3, 3)
    found: Matrix = np.concatenate([np.broadcast_to(np.eye(3), turns.shape), turns], axis=1)
    return found
