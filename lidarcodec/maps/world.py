"""MapWorld: a map in which scans are registered, point to plane, with the map's own normals if it has them.

small_gicp finds the nearest points, and does all of the work for a map without normals. Its Python interface cannot be
given normals, so for a map that has them the steps of Gauss and Newton are here (Chen and Medioni, "Object modelling by
registration of multiple range images", 1992).
"""

from __future__ import annotations

from typing import Final

import numpy as np

from lidarcodec.errors import SourceError
from lidarcodec.evaluation.localisation.icp import Schedule, Stage, sample_of
from lidarcodec.evaluation.rigid import Matrix, exp_so3, invert, moved
from lidarcodec.evaluation.trajectory import PlaneMap
from lidarcodec.maps.points import MapPoints

NEIGHBOURS: Final = 20
FEWEST: Final = 50


class MapWorld:
    """A map for point-to-plane ICP. Raises SourceError for fewer than 50 points."""

    def __init__(self, points: MapPoints) -> None:
        import small_gicp

        if len(points) < FEWEST:
            raise SourceError(f"a map of {len(points)} points is too small to register scans")
        # around the origin, because turns about one that is far away are badly conditioned
        self._middle = np.eye(4)
        self._middle[:3, 3] = np.floor(points.xyz.mean(axis=0))
        self._points, self._normals = np.ascontiguousarray(points.xyz - self._middle[:3, 3]), points.normals
        self._estimated = PlaneMap(self._points, NEIGHBOURS) if self._normals is None else None
        self._tree = small_gicp.KdTree(self._points)

    def align(self, cloud: Matrix, start: Matrix, stages: Schedule) -> Matrix:
        """(4, 4) T_world_sensor of a cloud (N, 3) in the sensor's frame; `start` for a cloud of too few points."""
        pose: Matrix = invert(self._middle) @ start
        for stage in stages if len(cloud) >= FEWEST else ():
            source = sample_of(cloud, stage.share)
            if self._estimated is not None:
                pose = self._estimated.align(source, pose, ((stage.distance_m, stage.iterations, stage.step_m),))
            else:
                pose = self._aligned(source, pose, stage)
        back: Matrix = self._middle @ pose
        return back

    def _aligned(self, source: Matrix, pose: Matrix, stage: Stage) -> Matrix:
        assert self._normals is not None
        for _ in range(stage.iterations):
            there = moved(pose, source)
            places, squared = (np.asarray(found) for found in self._tree.batch_nearest_neighbor_search(there, 1))
            near = squared < stage.distance_m**2
            if np.count_nonzero(near) < FEWEST:
                break
            places, there = places[near], there[near]
            normals = self._normals[places]
            off = np.einsum("ij,ij->i", there - self._points[places], normals)
            middle = pose[:3, 3]
            slopes = np.hstack([normals, np.cross(there - middle, normals)])
            system = slopes.T @ slopes + 1e-6 * np.eye(6)
            step = -np.linalg.solve(system, slopes.T @ off)
            pose = pose.copy()
            pose[:3, :3] = exp_so3(step[3:]) @ pose[:3, :3]
            pose[:3, 3] = middle + step[:3]
            if np.linalg.norm(step[:3]) < stage.step_m and np.linalg.norm(step[3:]) < stage.step_m / 20:
                break
        return pose
