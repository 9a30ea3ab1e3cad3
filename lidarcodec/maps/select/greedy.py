"""`greedy`: the points that cover all places of the path in all directions, spread over space.

With at most K points S it maximises

    sum over places p and directions d of min(b, points of S that p sees and that face d)
    + spread * sum over groups g of (1 + 1/2 + ... + 1/n_g)

A direction is that of the normal: up, or one of four ways along the ground. So where few points hold a scan in one
direction, as along a straight road, these are kept. n_g is the number of points of S in group g, a cube and a
direction. Each part is monotone and submodular, so lazy greedy comes within 1 - 1/e of the best (Nemhauser, Wolsey and
Fisher, "An analysis of approximations for maximizing submodular set functions", 1978). A place sees a point from the
first to the last one from which it was hit; gaps in between are not known. Of each group only the points with the
flattest surroundings are candidates: what lies on a plane ties a scan down, and a leaf of a hedge does not.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec import _native
from lidarcodec.evaluation.rigid import Matrix
from lidarcodec.maps.points import MapPoints
from lidarcodec.maps.select.result import Selection, check_seen

SPREAD: Final = 1.0
"""Worth of the first point of a group, in mean gains of a point by the places that see it."""
DIRECTIONS: Final = 5
FLATTEST: Final = 0.3
NEIGHBOURS: Final = 10
UP: Final = 0.8
"""Least height of a normal that faces up."""


def greedy(points: MapPoints, count: int, seed: int) -> Selection:
    """The points of lazy greedy. Raises SettingsError for a map that does not say from where points were seen."""
    del seed
    check_seen(points, "greedy")
    first, last = (points.columns[name].astype(np.int32) for name in ("first", "last"))
    facing, places = _facing(points), len(points.path)
    sees = float((last - first + 1).mean())
    enough = count * sees / (places * DIRECTIONS)
    group, groups = _groups(points, facing, count)
    share = max(FLATTEST, min(2 * count / len(points), 1.0))
    candidates = _flattest(flatness(points.xyz), group, share)
    rows = facing * places  # each direction has rows of its own for all places
    chosen = _native.greedy_cover(
        (first + rows)[candidates], (last + rows)[candidates], group[candidates], places * DIRECTIONS, groups, enough,
        SPREAD * sees, min(count, len(candidates)),
    )  # fmt: skip
    return Selection(points.taken(np.sort(candidates[chosen])), {})


def flatness(xyz: Matrix) -> npt.NDArray[np.float32]:
    """(N,) up to 1 for points (N, 3): 1 where the neighbours of a point lie on a plane."""
    import small_gicp

    around = np.ascontiguousarray(xyz - xyz.mean(axis=0))
    tree, near = small_gicp.KdTree(around), min(NEIGHBOURS, len(xyz))
    found = np.empty(len(xyz), np.float32)
    for begin in range(0, len(xyz), 100_000):
        part = around[begin : begin + 100_000]
        neighbours = around[np.asarray(tree.batch_knn_search(part, near, 1)[0], np.int64)]
        off = neighbours - neighbours.mean(axis=1, keepdims=True)
        values = np.linalg.eigvalsh(np.einsum("nki,nkj->nij", off, off))
        found[begin : begin + len(part)] = 1 - np.sqrt(np.maximum(values[:, 0], 0) / np.maximum(values[:, 1], 1e-9))
    return found


def _flattest(flat: npt.NDArray[np.float32], group: npt.NDArray[np.int32], share: float) -> npt.NDArray[np.intp]:
    """Places of a share of the points of each group, at least one, those of the largest flatness."""
    order = np.lexsort((-flat, group))
    sizes = np.bincount(group)
    rank = np.arange(len(order)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    found: npt.NDArray[np.intp] = np.sort(order[rank < np.ceil(share * np.repeat(sizes, sizes))])
    return found


def _facing(points: MapPoints) -> npt.NDArray[np.int32]:
    """(N,) direction of each point, 0 to 4; all 0 without normals."""
    normals = points.normals
    if normals is None:
        return np.zeros(len(points), np.int32)
    sector = np.floor(np.arctan2(normals[:, 1], normals[:, 0]) / (np.pi / 4) + 0.5).astype(np.int32) % 4
    return np.where(normals[:, 2] > UP, 0, 1 + sector).astype(np.int32)


def _groups(points: MapPoints, facing: npt.NDArray[np.int32], count: int) -> tuple[npt.NDArray[np.int32], int]:
    """Group of each point, and their number: cubes of a size at which there are about `count` groups."""
    low, high = 0.2, 200.0
    for _ in range(16):
        middle = float(np.sqrt(low * high))
        groups = len(np.unique(_keys(points, facing, middle)))
        low, high = (middle, high) if groups > count else (low, middle)
    _, at = np.unique(_keys(points, facing, high), return_inverse=True)
    return at.astype(np.int32), int(at.max(initial=-1)) + 1


def _keys(points: MapPoints, facing: npt.NDArray[np.int32], width: float) -> npt.NDArray[np.int64]:
    cells = np.floor(points.xyz / width).astype(np.int64)
    cells -= cells.min(axis=0)
    spans = cells.max(axis=0) + 1
    numbers = (cells[:, 2] * spans[1] + cells[:, 1]) * spans[0] + cells[:, 0]
    keys: npt.NDArray[np.int64] = numbers * DIRECTIONS + facing
    return keys
