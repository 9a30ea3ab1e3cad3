"""Two odometry methods: kiss-icp, and scan to map by small_gicp. One object for each drive.

Both take the deskewed points of a scan and a guess of its pose, and return its pose.
"""

from __future__ import annotations

from typing import Any, Final, Protocol

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import MissingExtraError

Matrix = npt.NDArray[np.float64]

KISS_VOXEL_M: Final = 0.6
"""Voxel size. kiss-icp's default is a hundredth of the range, so 1 m; smaller voxels drift less on a main road."""
FARTHEST_M: Final = 100.0
_GICP_CELL_M, _GICP_VOXEL_M = 0.4, 0.8
_LEAST_POINTS: Final = 50


class Odometer(Protocol):
    """Poses of scans in their order."""

    def next(self, points: Matrix, guess: Matrix) -> Matrix:
        """(4, 4) the sensor's pose for the points (N, 3), in the world of the first scan. guess: approximate pose"""


class KissOdometer:
    """kiss-icp 1.x in one thread. Raises MissingExtraError if it is not installed."""

    def __init__(self) -> None:
        try:
            from kiss_icp.config import KISSConfig
            from kiss_icp.kiss_icp import KissICP
        except ImportError:
            raise MissingExtraError("odometry by kiss-icp", "annotate") from None
        config = KISSConfig()
        config.data.max_range, config.data.min_range, config.data.deskew = FARTHEST_M, 0.0, False
        config.mapping.voxel_size, config.registration.max_num_threads = KISS_VOXEL_M, 1
        self._chain: Any = KissICP(config)

    def next(self, points: Matrix, guess: Matrix) -> Matrix:
        """The pose; the guess if the scan has too few points."""
        if len(points) < _LEAST_POINTS:
            return guess
        self._chain.last_delta = np.linalg.inv(self._chain.last_pose) @ guess
        self._chain.register_frame(points, np.zeros(len(points)))
        pose: Matrix = np.array(self._chain.last_pose, np.float64)
        return pose


class GicpOdometer:
    """Registers each scan in Gaussian voxels of the earlier scans (VGICP of small_gicp), in one thread."""

    def __init__(self) -> None:
        import small_gicp

        self._map = small_gicp.GaussianVoxelMap(_GICP_VOXEL_M)
        self._map.set_lru(horizon=100, clear_cycle=10)

    def next(self, points: Matrix, guess: Matrix) -> Matrix:
        """The pose; the guess if the scan has too few points."""
        import small_gicp

        if len(points) < _LEAST_POINTS:
            return guess
        cloud, _ = small_gicp.preprocess_points(np.ascontiguousarray(points), _GICP_CELL_M, 10, 1)
        pose = guess
        if self._map.size():
            for reach_m in (2.0, 0.7):
                result = small_gicp.align(
                    self._map, cloud, pose, max_correspondence_distance=reach_m, num_threads=1, max_iterations=30
                )
                pose = np.asarray(result.T_target_source, np.float64)
        self._map.insert(cloud, pose)
        return pose
