"""What a network for maps learns, and how near its choice comes to that of the programme."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec.maps.points import MapPoints
from lidarcodec.maps.select.programme import places_of
from lidarcodec.maps.select.windows import coordinates, windows_of


class Labelled(NamedTuple):
    """points: a map, or a half of one; kept: (N,) bool, what the programme keeps"""

    points: MapPoints
    kept: npt.NDArray[np.bool_]

    def windows(self) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.bool_]]:
        """(W, 1024, 3) coordinates and (W, 1024) what is kept."""
        windows = windows_of(self.points)
        return coordinates(self.points, windows), self.kept[windows]


def labelled(points: MapPoints, share: float, seed: int = 1) -> Labelled:
    """The points of a map with what the programme keeps at a share, 0 to 1.

    Raises SettingsError for a map without its path and counts, MissingExtraError without HiGHS.
    """
    places, _ = places_of(points, max(round(share * len(points)), 1), seed)
    kept = np.zeros(len(points), np.bool_)
    kept[places] = True
    return Labelled(points, kept)


def best(scores: npt.NDArray[np.float32], count: int) -> npt.NDArray[np.int64]:
    """(count,) places of the highest scores, increasing."""
    found: npt.NDArray[np.int64] = np.sort(np.argsort(-scores, kind="stable")[:count])
    return found


def alike(truth: Labelled, scores: npt.NDArray[np.float32]) -> float:
    """Of the points that the programme keeps, the share that scores keep, too, when they keep as many."""
    chosen = best(scores, int(truth.kept.sum()))
    return float(truth.kept[chosen].mean())


def nearest_m(points: MapPoints, others: MapPoints) -> npt.NDArray[np.float64]:
    """(N,) metres from each point to the nearest of the others."""
    import small_gicp

    middle = others.xyz.mean(axis=0)
    tree = small_gicp.KdTree(np.ascontiguousarray(others.xyz - middle))
    _, squares = tree.batch_nearest_neighbor_search(np.ascontiguousarray(points.xyz - middle))
    found: npt.NDArray[np.float64] = np.sqrt(np.asarray(squares, np.float64).reshape(-1))
    return found
