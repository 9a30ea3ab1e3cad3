"""Two choices that look at positions only: `random`, and `voxel`, the means of larger cells.

>>> line = MapPoints(0.02, np.arange(30).reshape(10, 3) * 10)
>>> len(random_points(line, 4, 1).points), len(voxel(line, 4, 1).points) <= 4
(4, True)
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from lidarcodec.maps.points import MapPoints, packed_normals
from lidarcodec.maps.select.result import Selection
from lidarcodec.maps.tiles import unlike

_TRIES = 24


def random_points(points: MapPoints, count: int, seed: int) -> Selection:
    """Points by lot."""
    chosen = np.random.default_rng(seed).permutation(len(points))[:count]
    return Selection(points.taken(np.sort(chosen)), {})


def voxel(points: MapPoints, count: int, seed: int) -> Selection:
    """The means of cells, as large as needed for at most `count` of them. A normal is the mean of those in the cell."""
    del seed
    low, high = 1.0, 2.0
    while len(np.unique(_cells(points, high))) > count:
        high *= 2
    for _ in range(_TRIES):
        middle = (low + high) / 2
        low, high = (middle, high) if len(np.unique(_cells(points, middle))) > count else (low, middle)
    _, at = np.unique(_cells(points, high), return_inverse=True)
    cells = int(at.max(initial=-1)) + 1
    numbers = np.bincount(at, minlength=cells)
    means = np.stack([np.bincount(at, points.steps[:, axis], cells) for axis in range(3)], axis=1) / numbers[:, None]
    columns = {}
    normals = points.normals
    if normals is not None:
        columns["normal_a"], columns["normal_b"] = packed_normals(_mean_normals(normals, at, cells))
    for name, start, join in (("count", 0, np.maximum), ("first", 0xFFFF, np.minimum), ("last", 0, np.maximum)):
        if name in points.columns:
            columns[name] = np.full(cells, start, np.uint16)
            join.at(columns[name], at, points.columns[name])
    found = replace(points, steps=np.rint(means).astype(np.int64), columns=columns)
    found = found.taken(unlike(found.steps))
    return Selection(found, {"cell_m": round(high * points.step_m, 4)})


def _cells(points: MapPoints, width: float) -> npt.NDArray[np.int64]:
    cells = np.floor(points.steps / width).astype(np.int64)
    cells -= cells.min(axis=0)
    spans = cells.max(axis=0) + 1
    numbers: npt.NDArray[np.int64] = (cells[:, 2] * spans[1] + cells[:, 1]) * spans[0] + cells[:, 0]
    return numbers


def _mean_normals(normals: npt.NDArray[np.float64], at: npt.NDArray[np.intp], cells: int) -> npt.NDArray[np.float64]:
    """Unit vectors, (cells, 3). A normal and its opposite are the same, so each is turned to the first of its cell."""
    first = np.zeros((cells, 3))
    first[at[::-1]] = normals[::-1]
    alike = np.sign(np.einsum("ij,ij->i", normals, first[at]))
    sums = np.stack([np.bincount(at, normals[:, axis] * alike, cells) for axis in range(3)], axis=1)
    length = np.linalg.norm(sums, axis=1, keepdims=True)
    found: npt.NDArray[np.float64] = np.where(length > 1e-6, sums / np.maximum(length, 1e-6), (0.0, 0.0, 1.0))
    return found
