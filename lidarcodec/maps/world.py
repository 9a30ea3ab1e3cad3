"""MapWorld: a map in which scans are registered, point to plane, with the map's own normals if it has them.

small_gicp finds the nearest points, and the normals of a map without any. Its Python interface cannot be given
normals, so the steps of Gauss and Newton are here (Chen and Medioni, "Object modelling by registration of multiple
range images", 1992). `fit` also says how well a scan lies in the map, and how uncertain its pose is.

>>> ground = np.stack([*np.meshgrid(np.arange(400), np.arange(400)), np.zeros((400, 400))], -1).reshape(-1, 3)
>>> walls = [ground[:, [0, 2, 1]], ground[:, [2, 0, 1]]]
>>> town = MapPoints(0.02, np.unique(np.concatenate([ground, *walls])[::7].astype(np.int64), axis=0))
>>> start = np.eye(4)
>>> start[:3, 3] = 0.2
>>> fit = MapWorld(town).fit(town.xyz, start, NEAR)
>>> bool(np.abs(fit.pose[:3, 3]).max() < 1e-3), fit.share > 0.99
(True, True)
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import SourceError
from lidarcodec.evaluation.localisation.icp import Schedule, Stage, sample_of
from lidarcodec.evaluation.rigid import Matrix, exp_so3, invert, log_so3, moved
from lidarcodec.maps.points import MapPoints

NEIGHBOURS: Final = 20
FEWEST: Final = 50
NEAR: Final = (Stage(1.0, 6, 1, 0.01), Stage(0.5, 15, 1, 1e-3))
"""Stages for a start that a model of the motion predicts."""
MATCH_M: Final = 1.0
"""A return has a partner in the map if the nearest point is within this distance."""
CLOSE_M: Final = 0.1
"""A return lies on the map if it is within this distance of the plane of its partner."""
UPRIGHT: Final = 0.7
"""A plane stands upright if its normal rises by less than this."""
FLAT: Final = 0.9
"""A plane is flat ground if its normal rises by more than this. It says nothing of where along it a sensor is."""
FACES: Final = 0.3
"""A plane faces a direction if that part of its normal lies along it."""
LEAST_NOISE_M: Final = 0.01
INFLATED: Final = 10.0
"""Factor of the covariance: returns side by side err alike, because they meet the same plane of the map. Measured: with
it, errors of tracked scans are as large as their standard deviations say."""
ROBUST_M, ROBUST_SHARE = 0.1, 0.0
"""Where the weight of a residual begins to fall, Huber's threshold: at least so much, and a share of the distance of
partners, because a start that is metres off leaves large residuals."""


class Prior(NamedTuple):
    """A pose that is expected, (4, 4), and the information about it (6, 6): of position and rotation in map axes."""

    pose: Matrix
    information: Matrix


class Fit(NamedTuple):
    """A registered scan.

    pose: (4, 4) T_map_sensor
    covariance: (6, 6) of position in m and rotation vector in rad, both along the axes of the map
    share: of the returns that have a partner, those that lie on the map, 0 to 1
    partners: share of all returns that have a partner
    facing: returns that lie on planes of the map that face the direction in which the position is least certain
    """

    pose: Matrix
    covariance: Matrix
    share: float
    partners: float
    facing: int


class MapWorld:
    """A map for point-to-plane registration. Raises SourceError for fewer than 50 points."""

    def __init__(self, points: MapPoints) -> None:
        import small_gicp

        if len(points) < FEWEST:
            raise SourceError(f"the map has {len(points)} points, which is too few to register scans")
        # around the origin, because turns about one that is far away are badly conditioned
        self._middle = np.eye(4)
        self._middle[:3, 3] = np.floor(points.xyz.mean(axis=0))
        self._points = np.ascontiguousarray(points.xyz - self._middle[:3, 3])
        self._tree = small_gicp.KdTree(self._points)
        normals = points.normals
        if normals is None:
            cloud = small_gicp.PointCloud(self._points)
            small_gicp.estimate_normals(cloud, small_gicp.KdTree(cloud), NEIGHBOURS, 1)
            normals = np.asarray(cloud.normals())[:, :3]
        self._normals: Matrix = np.ascontiguousarray(normals)

    def align(self, cloud: Matrix, start: Matrix, stages: Schedule) -> Matrix:
        """(4, 4) T_world_sensor of a cloud (N, 3) in the sensor's frame; `start` for a cloud of too few points."""
        back: Matrix = self._middle @ self._aligned(cloud, invert(self._middle) @ start, stages, None, level=False)
        return back

    def fit(self, cloud: Matrix, start: Matrix, stages: Schedule, prior: Prior | None = None) -> Fit:
        """The registered cloud (N, 3). Of one with fewer than 50 points, `start` with an infinite covariance."""
        if len(cloud) < FEWEST:
            return Fit(start, np.full((6, 6), np.inf), 0.0, 0.0, 0)
        near = invert(self._middle)
        if prior is not None:
            prior = Prior(near @ prior.pose, prior.information)
        pose = self._aligned(cloud, near @ start, stages, prior)
        return self._judged(cloud, pose, prior)

    def upright(self, cloud: Matrix, pose: Matrix) -> float:
        """Share of the returns of a cloud (N, 3) that lie on planes of the map that stand upright."""
        off, slopes = self._matched(cloud, invert(self._middle) @ pose, MATCH_M)
        on_wall = (np.abs(off) < CLOSE_M) & (np.abs(slopes[:, 2]) < UPRIGHT)
        return float(np.count_nonzero(on_wall) / max(len(cloud), 1))

    def off_planes(self, cloud: Matrix, pose: Matrix) -> Matrix:
        """(N,) distance of each return of a cloud (N, 3) to the plane of its partner; infinite without a partner."""
        there = moved(invert(self._middle) @ pose, cloud)
        places, squared = (found[:, 0] for found in self._tree.batch_knn_search(there, 1))
        at = places.astype(np.int64)
        off = np.abs(np.einsum("ij,ij->i", there - self._points[at], self._normals[at]))
        found: Matrix = np.where(squared < MATCH_M**2, off, np.inf)
        return found

    def _aligned(
        self, cloud: Matrix, pose: Matrix, stages: Schedule, prior: Prior | None, *, level: bool = True
    ) -> Matrix:
        """level: whether flat planes say height, roll and pitch only"""
        for stage in stages if len(cloud) >= FEWEST else ():
            pose = self._stepped(sample_of(cloud, stage.share), pose, stage, prior, level=level)
        return pose

    def _stepped(self, source: Matrix, pose: Matrix, stage: Stage, prior: Prior | None, *, level: bool) -> Matrix:
        robust = max(ROBUST_M, ROBUST_SHARE * stage.distance_m)
        for _ in range(stage.iterations):
            off, slopes = self._matched(source, pose, stage.distance_m)
            if len(off) < FEWEST:
                break
            weights = robust / np.maximum(np.abs(off), robust)
            system, slope = _system(off, _level(slopes) if level else slopes, weights)
            system += 1e-6 * np.eye(6)
            if prior is not None:
                variance = INFLATED * max(float((weights * off**2).mean()), LEAST_NOISE_M**2)
                system += variance * prior.information
                slope += variance * (prior.information @ _apart(prior.pose, pose))
            step: Matrix = -np.linalg.solve(system, slope).astype(np.float64)
            pose = pose.copy()
            pose[:3, :3] = exp_so3(step[3:]) @ pose[:3, :3]
            pose[:3, 3] += step[:3]
            if np.linalg.norm(step[:3]) < stage.step_m and np.linalg.norm(step[3:]) < stage.step_m / 20:
                break
        return pose

    def _matched(self, source: Matrix, pose: Matrix, distance_m: float) -> tuple[Matrix, Matrix]:
        """Of points with a partner: distance to its plane (K,), slopes of that (K, 6)."""
        there = moved(pose, source)
        places, squared = (found[:, 0] for found in self._tree.batch_knn_search(there, 1))
        near = squared < distance_m**2
        places, there = places[near].astype(np.int64), there[near]
        normals = self._normals[places]
        off = np.einsum("ij,ij->i", there - self._points[places], normals)
        x, y, z = (there - pose[:3, 3]).T
        a, b, c = normals.T
        slopes = np.stack([a, b, c, y * c - z * b, z * a - x * c, x * b - y * a], axis=1)
        return off, slopes

    def _judged(self, cloud: Matrix, pose: Matrix, prior: Prior | None) -> Fit:
        off, slopes = self._matched(cloud, pose, MATCH_M)
        back: Matrix = self._middle @ pose
        if len(off) < FEWEST:
            return Fit(back, np.full((6, 6), np.inf), 0.0, len(off) / len(cloud), 0)
        close = np.abs(off) < CLOSE_M
        on_map = np.count_nonzero(close)
        system, _ = _system(off, _level(slopes), close.astype(np.float64))
        variance = max(float((off[close] ** 2).mean()) if on_map else np.inf, LEAST_NOISE_M**2)
        information = system / (INFLATED * variance) + 1e-9 * np.eye(6)
        weakest = np.linalg.eigh(inverse(information)[:3, :3])[1][:, -1]
        facing = int(np.count_nonzero(close & (np.abs(slopes[:, :3] @ weakest) > FACES)))
        if prior is not None:
            information += prior.information
        return Fit(back, inverse(information), float(on_map / len(off)), len(off) / len(cloud), facing)


def inverse(matrix: Matrix) -> Matrix:
    """(6, 6) the covariance of an information matrix, or the reverse."""
    found: Matrix = np.linalg.inv(matrix).astype(np.float64)
    return found


def _system(off: Matrix, slopes: Matrix, weights: Matrix) -> tuple[Matrix, npt.NDArray[np.float64]]:
    """The weighted normal equations (6, 6), (6,)."""
    weighted = slopes * weights[:, None]
    # not with @: for such a small product BLAS threads wait for each other longer than they compute
    return np.einsum("ij,ik->jk", weighted, slopes), np.einsum("ij,i->j", weighted, off)


def _level(slopes: Matrix) -> Matrix:
    """Slopes (K, 6), of which those of flat planes say height, roll and pitch only.

    Bumps of the ground lie where the sensor's rings meet it, and these go with the vehicle.
    """
    level = slopes.copy()
    flat = np.abs(slopes[:, 2]) > FLAT
    level[:, [0, 1, 5]] *= ~flat[:, None]
    return level


def _apart(expected: Matrix, pose: Matrix) -> Matrix:
    """(6,) position and rotation vector from the expected pose to a pose, along the axes of the world."""
    turn = pose[:3, :3] @ expected[:3, :3].T
    apart: Matrix = np.concatenate([pose[:3, 3] - expected[:3, 3], log_so3(turn[None])[0]])
    return apart
