"""Keypoints: 3D Harris on normals, and intrinsic shape signatures (ISS), with search trees.

These are baselines of the paper. Both take the points of a frame and a number, and return the indices of keypoints.
SIFT on clouds is not included: no library without a window system has it.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.evaluation.geometry import Cloud
from lidarcodec.evaluation.rigid import Matrix

Places = npt.NDArray[np.intp]
NEIGHBOURS: Final = 24
SALIENT_RATIO: Final = 0.975
CELL_M: Final = 0.25
"""Side of the cells of non-maximum suppression: only the best point of a cell is a keypoint."""
HARRIS_K: Final = 0.04


def harris(points: Matrix, count: int) -> Places:
    """Sorted indices of the highest Harris responses det(C) - k trace(C)^3; C is the mean of n n' over 24
    neighbours.
    """
    tree = Cloud(points)
    normals = tree.normals()[tree.neighbours(points, NEIGHBOURS)]
    spread = np.einsum("nki,nkj->nij", normals, normals) / NEIGHBOURS
    response = np.linalg.det(spread) - HARRIS_K * np.trace(spread, axis1=1, axis2=2) ** 3 / 9
    return _best(points, response, np.argsort(-response, kind="stable"), count)


def iss(points: Matrix, count: int) -> Places:
    """Sorted indices of the points with the largest third eigenvalue of the scatter matrix of their 24 neighbours. Each
    eigenvalue must be below 0.975 of the next larger one, so that all three directions differ (Zhong 2009)."""
    apart = points[Cloud(points).neighbours(points, NEIGHBOURS)] - points[:, None]
    values = np.linalg.eigvalsh(np.einsum("nki,nkj->nij", apart, apart) / NEIGHBOURS)
    clear = (values[:, 1] < SALIENT_RATIO * values[:, 2]) & (values[:, 0] < SALIENT_RATIO * values[:, 1])
    salient = np.flatnonzero(clear)
    return _best(points, values[:, 0], salient[np.argsort(-values[salient, 0], kind="stable")], count)


def _best(points: Matrix, score: Matrix, order: Places, count: int) -> Places:
    cell = np.floor(points[order] / CELL_M).astype(np.int64) + (1 << 20)
    keys = (cell[:, 0] << 42) | (cell[:, 1] << 21) | cell[:, 2]
    best = order[np.unique(keys, return_index=True)[1]]
    return np.sort(best[np.argsort(-score[best], kind="stable")[:count]])
