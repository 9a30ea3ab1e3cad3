"""Detects the road: a plane by RANSAC, as in the PocoNet paper, or patchwork++.

Heights are relative to the sensor, z up, and the sensor is 1-3 m above the road. RANSAC finds the plane near the
vehicle. But roads are crowned, have kerbs, and bend further away. So a return near the plane is also ground if it is
near the lowest return of its 4 m square. patchwork++ adapts over the frames of a drive, so one `Patchwork` is for one
drive, in order.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final, Protocol

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import MissingExtraError, UnknownNameError

METHODS: Final = ("ransac", "patchwork")
SENSOR_HEIGHT_M: Final = 1.73
"""Height of the sensor on KITTI's car and on the simulated one. patchwork++ starts with it and adapts."""

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

_TRIES, _SAMPLE = 150, 3000
_NEAR_M, _FAR_M = 15.0, 40.0
_ON_PLANE_M, _ABOUT_PLANE_M, _ON_SQUARE_M, _SQUARE_M = 0.15, 1.0, 0.2, 4.0
_UPRIGHT: Final = 0.95  # cosine of the plane's tilt
_LEAST: Final = 50


class GroundFinder(Protocol):
    """Detects ground points, scan by scan of a drive."""

    def ground(self, points: Floats) -> Bools:
        """(N,) bool of points (N, 3) in metres, x forward, y left, z up."""


def ground_finder(method: str, seed: int = 0) -> GroundFinder:
    """A ground detector for one drive. Raises UnknownNameError, MissingExtraError."""
    if method not in METHODS:
        raise UnknownNameError("way to find ground", method, METHODS)
    return Ransac(seed) if method == "ransac" else Patchwork()


class Ransac:
    """The plane with the most returns, and the lowest returns near it. Cost: 20 ms for 120,000 returns."""

    def __init__(self, seed: int = 0) -> None:
        self._seed = seed

    def ground(self, points: Floats) -> Bools:
        """(N,) bool, points on the road; none if no plane is found."""
        plane = self._plane(points)
        if plane is None:
            return np.zeros(len(points), np.bool_)
        height = points @ plane[:3] + plane[3]
        away = np.hypot(points[:, 0], points[:, 1])
        found: Bools = (np.abs(height) < _ON_PLANE_M) & (away <= _NEAR_M)
        about = np.flatnonzero(np.abs(height) < _ABOUT_PLANE_M)
        if len(about):
            square = np.floor(points[about, :2] / _SQUARE_M).astype(np.int64)
            _, place, many = np.unique(square[:, 0] * (1 << 32) + square[:, 1], return_inverse=True, return_counts=True)
            order = np.lexsort((height[about], place))
            first = np.cumsum(many) - many
            lowest = height[about][order][first + many // 10]  # lower returns are outliers
            found[about] |= height[about] < lowest[place] + _ON_SQUARE_M
        return found

    def _plane(self, points: Floats) -> Floats | None:
        """(4,) upward normal and offset: normal . p + offset is the height above the plane."""
        rng = np.random.default_rng(self._seed)
        below = points[(points[:, 2] < -0.8) & (np.hypot(points[:, 0], points[:, 1]) < _FAR_M)]
        if len(below) < _LEAST:
            return None
        tried = below[rng.integers(0, len(below), _SAMPLE)]
        a, b, c = (tried[rng.integers(0, _SAMPLE, _TRIES)] for _ in range(3))
        normals = np.cross(b - a, c - a)
        lengths = np.linalg.norm(normals, axis=1)
        normals = normals / np.maximum(lengths, 1e-12)[:, None]
        normals *= np.where(normals[:, 2:] < 0, -1.0, 1.0)
        possible = (lengths > 1e-6) & (normals[:, 2] > _UPRIGHT)
        if not possible.any():
            return None
        normals, offsets = normals[possible], -np.einsum("ij,ij->i", normals, a)[possible]
        support = (np.abs(tried @ normals.T + offsets) < _ON_PLANE_M).sum(axis=0)
        best = int(support.argmax())
        inliers = tried[np.abs(tried @ normals[best] + offsets[best]) < _ON_PLANE_M]
        centre = inliers.mean(axis=0)
        normal = np.linalg.svd(inliers - centre, full_matrices=False)[2][2]
        normal = normal if normal[2] > 0 else -normal
        return np.append(normal, -normal @ centre)


class Patchwork:
    """patchwork++ (extra `annotate`). Cost: 20-50 ms a scan. Raises MissingExtraError if it is not installed."""

    def __init__(self) -> None:
        try:
            import pypatchworkpp
        except ImportError:
            raise MissingExtraError("finding ground by patchwork++", "annotate") from None
        parameters = pypatchworkpp.Parameters()
        parameters.sensor_height, parameters.verbose = SENSOR_HEIGHT_M, False
        parameters.enable_RNR = False  # it needs a calibrated intensity
        with _silence():
            self._finder: Any = pypatchworkpp.patchworkpp(parameters)

    def ground(self, points: Floats) -> Bools:
        """(N,) bool, points on the road. The result also depends on earlier scans."""
        found = np.zeros(len(points), np.bool_)
        if len(points) >= _LEAST:
            self._finder.estimateGround(np.c_[points, np.zeros(len(points))].astype(np.float32))
            found[np.asarray(self._finder.getGroundIndices(), np.intp)] = True
        return found


@contextmanager
def _silence() -> Iterator[None]:
    """Suppress a greeting of native code on standard output, which belongs to the command."""
    sys.stdout.flush()
    kept, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1)
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)
