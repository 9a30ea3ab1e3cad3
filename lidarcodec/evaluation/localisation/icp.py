"""Where a cloud is in a map: point-to-plane ICP, or VGICP, coarse to fine, by small_gicp. Same settings for everyone.

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
"""Points that a stage takes at least, if there are as many."""


class Stage(NamedTuple):
    """One run of ICP. distance_m: how far a match may lie; share: every how many-th point is used; step_m: a smaller
    step ends it"""

    distance_m: float
    iterations: int
    share: int
    step_m: float


COARSE: Final = (Stage(5.0, 10, 4, 0.02), Stage(2.0, 15, 4, 0.01), Stage(0.8, 12, 2, 0.002), Stage(0.35, 20, 1, 3e-4))
"""From the last known place, metres away."""
FINE: Final = (Stage(1.2, 15, 2, 0.005), Stage(0.6, 15, 1, 1e-3), Stage(0.3, 20, 1, 2e-4))
"""From near by: what is left is the cloud's own error."""
Schedule = tuple[Stage, ...]


class World(Protocol):
    """What clouds are put into."""

    def align(self, cloud: Matrix, start: Matrix, stages: Schedule) -> Matrix:
        """(4, 4) T_world_sensor of a cloud (N, 3) in its sensor's frame; the start itself for an empty cloud."""


def sample_of(cloud: Matrix, share: int) -> Matrix:
    """Every so many-th point of the cloud, drawn at random, always the same; neighbours stay together, which is a
    quarter faster in the search tree."""
    chosen = np.random.default_rng(5).permutation(len(cloud))[: max(len(cloud) // share, FEWEST)]
    return np.ascontiguousarray(cloud[np.sort(chosen)], np.float64)


class PlaneWorld:
    """A map of points with normals from 20 neighbours. points: (N, 3) float64 in the world, at least 50."""

    def __init__(self, points: Matrix) -> None:
        self._map = PlaneMap(points, NEIGHBOURS)

    def align(self, cloud: Matrix, start: Matrix, stages: Schedule) -> Matrix:
        """By point-to-plane ICP: the nearest point of the map, and the distance along its normal."""
        pose = start
        for stage in stages:
            how = (stage.distance_m, stage.iterations, stage.step_m)
            pose = self._map.align(sample_of(cloud, stage.share), pose, (how,))
        return pose


class VoxelWorld:
    """A map of cells with a normal distribution in each: VGICP, the nearest relative of NDT that small_gicp has."""

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
        """In cells of 4 m, then 2 m, then 1 m; of the stages only the number of iterations is taken."""
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
