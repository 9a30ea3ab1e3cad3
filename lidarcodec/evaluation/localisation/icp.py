"""Registers a cloud in a map with small_gicp: point-to-plane ICP or VGICP, coarse to fine. All methods use the same
settings.

>>> floor = np.stack(np.meshgrid(np.arange(0, 8, 0.25), np.arange(0, 8, 0.25), [0.0]), axis=-1).reshape(-1, 3)
>>> room = np.concatenate([floor, floor[:, [0, 2, 1]], floor[:, [2, 0, 1]]])
>>> start = np.eye(4)
>>> start[:3, 3] = 0.3
>>> bool(np.abs(PlaneWorld(room).align(room, start, COARSE)[:3, 3]).max() < 1e-3)
True
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple, Protocol

import numpy as np

from lidarcodec.evaluation.rigid import Matrix
from lidarcodec.evaluation.trajectory import PlaneMap

NEIGHBOURS: Final = 20
FEWEST: Final = 300
"""Least number of points in a stage, if the cloud has so many."""


class Stage(NamedTuple):
    """One run of ICP. distance_m: largest distance of a match; share: every `share`-th point is used; step_m: it
    ends when a step is smaller"""

    distance_m: float
    iterations: int
    share: int
    step_m: float


COARSE: Final = (Stage(5.0, 10, 4, 0.02), Stage(2.0, 15, 4, 0.01), Stage(0.8, 12, 2, 0.002), Stage(0.35, 20, 1, 3e-4))
"""Stages for a start that is metres away, such as the last known pose."""
FINE: Final = (Stage(1.2, 15, 2, 0.005), Stage(0.6, 15, 1, 1e-3), Stage(0.3, 20, 1, 2e-4))
"""Stages for a near start: the remaining error is due to the cloud."""
Schedule = tuple[Stage, ...]


class World(Protocol):
    """A map in which clouds are registered."""

    def align(self, cloud: Matrix, start: Matrix, stages: Schedule) -> Matrix:
        """(4, 4) T_world_sensor of a cloud (N, 3) in the sensor's frame; `start` for an empty cloud."""


def sample_of(cloud: Matrix, share: int) -> Matrix:
    """A random sample of 1 / `share` of the points, with a fixed seed. Neighbours stay together, which makes the search
    tree a quarter faster."""
    chosen = np.random.default_rng(5).permutation(len(cloud))[: max(len(cloud) // share, FEWEST)]
    return np.ascontiguousarray(cloud[np.sort(chosen)], np.float64)


class PlaneWorld:
    """A map of points with normals from 20 neighbours. points: (N, 3) float64 in the world, at least 50."""

    def __init__(self, points: Matrix) -> None:
        self._map = PlaneMap(points, NEIGHBOURS)

    def align(self, cloud: Matrix, start: Matrix, stages: Schedule) -> Matrix:
        """Point-to-plane ICP: the distance to the nearest point of the map, along its normal."""
        pose = start
        for stage in stages:
            how = (stage.distance_m, stage.iterations, stage.step_m)
            pose = self._map.align(sample_of(cloud, stage.share), pose, (how,))
        return pose


class VoxelWorld:
    """A map of cells with a normal distribution each: VGICP, the method of small_gicp that is closest to NDT."""

    SIZES_M: Final = (4.0, 2.0, 1.0)

    def __init__(self, points: Matrix) -> None:
        import small_gicp

        cloud = small_gicp.PointCloud(points)
        small_gicp.estimate_covariances(cloud, small_gicp.KdTree(cloud), NEIGHBOURS, 1)
        self._maps = []
        for size in self.SIZES_M:
            cells = small_gicp.GaussianVoxelMap(size)
            cells.insert(cloud)
            self._maps.append(cells)

    def align(self, cloud: Matrix, start: Matrix, stages: Schedule) -> Matrix:
        """VGICP with cells of 4 m, then 2 m, then 1 m. It uses only the number of iterations of the stages."""
        import small_gicp

        pose = start
        if not len(cloud):
            return np.asarray(pose, np.float64)
        source = small_gicp.PointCloud(np.ascontiguousarray(cloud, np.float64))
        small_gicp.estimate_covariances(source, small_gicp.KdTree(source), NEIGHBOURS, 1)
        for cells, size in zip(self._maps, self.SIZES_M, strict=True):
            pose = small_gicp.align(
                cells, source, pose, max_correspondence_distance=size, num_threads=1,
                max_iterations=sum(stage.iterations for stage in stages) // 3, rotation_epsilon=1e-5,
                translation_epsilon=2e-4,
            ).T_target_source  # fmt: skip
        return np.asarray(pose, np.float64)


LOCALISERS: Final[dict[str, Callable[[Matrix], World]]] = {"plane": PlaneWorld, "vgicp": VoxelWorld}
