"""The map for localisation: means of cells over every fifth scan. It never contains a scored scan."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from lidarcodec.errors import SourceError
from lidarcodec.evaluation.localisation.drive import Drive
from lidarcodec.evaluation.localisation.reference import Reference
from lidarcodec.evaluation.rigid import Matrix, moved
from lidarcodec.evaluation.trajectory import MAP_CELL_M, CellMeans, voxel_means

FEWEST: Final = 100
"""Least number of points of a map."""


def merged(clouds: Iterable[Matrix], cell_m: float = MAP_CELL_M) -> Matrix:
    """(N, 3) means of cells, first within each cloud (N, 3) in the world, then over all clouds.

    Raises SourceError if there are fewer than 100 points.
    """
    means = CellMeans(cell_m)
    for cloud in clouds:
        means.add(voxel_means(cloud, cell_m))
    points = means.means()
    if len(points) < FEWEST:
        raise SourceError(f"the map has {len(points)} points, which is too few for localisation")
    return points


def whole_map(drive: Drive, reference: Reference, mapped: Iterable[int], cell_m: float = MAP_CELL_M) -> Matrix:
    """(N, 3) the map from all returns of the mapped scans."""
    return merged(
        (moved(reference.poses[at], drive.cloud(at, reference.velocities[at])) for at in mapped),
        cell_m,
    )
