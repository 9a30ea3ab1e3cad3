"""Windows: what the network of `--by learned` sees at once, 1,024 points that follow each other along the path.

Each point belongs to the place of the path that is nearest. Points are ordered by their place, and by lot at one place,
so that a window shows a whole neighbourhood, thinned out. The last window repeats some of its points by lot, as Zhang
et al. have it. Coordinates are relative to the mean of the window, and scaled to a cube of side 1.

>>> line = MapPoints(0.02, np.arange(90).reshape(30, 3) * 10, path=np.zeros((2, 3), np.float32))
>>> places = windows_of(line)
>>> places.shape, len(np.unique(places)), coordinates(line, places).shape
((1, 1024), 30, (1, 1024, 3))
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import SettingsError
from lidarcodec.maps.points import MapPoints

SIZE: Final = 1024
_SEED: Final = 1
Ints = npt.NDArray[np.int64]
Floats = npt.NDArray[np.float32]


def windows_of(points: MapPoints) -> Ints:
    """(W, 1024) numbers of points. Each point is in one of them. Raises SettingsError for a map without its path."""
    order = along_path(points)
    spare = -len(order) % SIZE
    last = order[-(len(order) % SIZE or SIZE) :]
    again = np.random.default_rng(_SEED).choice(last, spare) if spare else last[:0]
    return np.concatenate([order, again]).reshape(-1, SIZE)


def along_path(points: MapPoints) -> Ints:
    """(N,) numbers of points, ordered by the nearest place of the path, and by lot at one place."""
    nearest = nearest_places(points)
    lots = np.random.default_rng(_SEED).random(len(points))
    found: Ints = np.lexsort((lots, nearest))
    return found


def halves(points: MapPoints) -> tuple[MapPoints, MapPoints]:
    """The points near the first half of the path, and those near the second one."""
    second = nearest_places(points) >= len(points.path) / 2
    return points.taken(np.flatnonzero(~second)), points.taken(np.flatnonzero(second))


def nearest_places(points: MapPoints) -> Ints:
    """(N,) the nearest place of the path. Raises SettingsError for a map without its path."""
    import small_gicp

    if not len(points.path) or not len(points):
        raise SettingsError(
            "--by learned needs a map from `map build`: a compressed map no longer has the path of the drives", "by"
        )
    path = points.path.astype(np.float64)
    middle = path.mean(axis=0)
    nearest, _ = small_gicp.KdTree(np.ascontiguousarray(path - middle)).batch_nearest_neighbor_search(
        np.ascontiguousarray(points.xyz - middle)
    )
    found: Ints = np.asarray(nearest, np.int64).reshape(-1)
    return found


def coordinates(points: MapPoints, windows: Ints) -> Floats:
    """(W, 1024, 3) between 0 and 1, with one scale for the three axes of a window."""
    xyz = points.xyz[windows]
    xyz -= xyz.mean(axis=1, keepdims=True)
    xyz -= xyz.min(axis=1, keepdims=True)
    xyz /= np.maximum(xyz.max(axis=(1, 2), keepdims=True), points.step_m)
    return xyz.astype(np.float32)
