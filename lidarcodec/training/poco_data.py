"""The input of PocoNet: some returns of a scan, and for each stage their neighbours and the sampled ones.

4096 * 30 returns, as in the paper, or fewer on a machine without a GPU. If a scan has fewer returns, some are repeated
at random. If it has more, a random part is used, and each other return gets the result of its nearest used return.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from lidarcodec.frame import Frame
from lidarcodec.training.annotation_folder import Labels
from lidarcodec.training.nets.poconet import NEIGHBOURS, STAGES

PAPER_POINTS: Final = 4096 * 30
CPU_POINTS: Final = 4096 * 2
QUARTER: Final = 4
LEAST_POINTS: Final = 2 * QUARTER ** len(STAGES)
"""Least number of points, so that each stage has points left, and batch normalisation works with one scan."""


class PocoScan(NamedTuple):
    """points: (N, 3) float32, metres; features: (N, 4) float32, x y z and intensity / 255; labels: (N,) int64, 0 low,
    1 high, 2 ground; nearest: (R,) intp, for each of the frame's returns the nearest used one."""

    points: npt.NDArray[np.float32]
    features: npt.NDArray[np.float32]
    labels: npt.NDArray[np.int64]
    nearest: npt.NDArray[np.intp]


class Levels(NamedTuple):
    """The arguments of PocoNet besides the features, one tensor for each stage."""

    points: list[Tensor]
    near: list[Tensor]
    kept: list[Tensor]
    up: list[Tensor]


def poco_scan(frame: Frame, truth: Labels | None, count: int, rng: np.random.Generator) -> PocoScan | None:
    """`count` returns of a frame; labels are 0 without `truth`. None for a frame without returns."""
    cloud = frame.cloud()
    if not len(cloud):
        return None
    points = np.stack([cloud[axis] for axis in "xyz"], axis=1)
    chosen = rng.permutation(len(points))[:count]
    nearest = _nearest(points[chosen], points, 1)[:, 0]
    if len(chosen) < count:
        chosen = np.append(chosen, rng.choice(len(points), count - len(chosen)))
    labels = np.zeros(count, np.int64)
    if truth is not None:
        labels = truth.labels.T[frame.valid.T][chosen].astype(np.int64) - 1
    features = np.hstack([points[chosen], cloud["intensity"][chosen, None].astype(np.float32) / 255])
    return PocoScan(points[chosen], features, labels, nearest)


def levels_of(scans: Sequence[PocoScan], rng: np.random.Generator, device: torch.device) -> Levels:
    """One random sampling for a batch of scans with equal numbers of points."""
    stacked: list[list[tuple[npt.NDArray[Any], ...]]] = [[] for _ in STAGES]
    for scan in scans:
        points = scan.points
        for stage in stacked:
            kept = rng.permutation(len(points))[: max(len(points) // QUARTER, 1)]
            near, up = _nearest(points, points, NEIGHBOURS), _nearest(points[kept], points, 1)[:, 0]
            stage.append((points.T, near, kept, up))
            points = points[kept]

    def tensors(part: int, dtype: torch.dtype) -> list[Tensor]:
        planes = [np.stack([draw[part] for draw in stage]) for stage in stacked]
        return [torch.from_numpy(np.ascontiguousarray(plane)).to(device, dtype) for plane in planes]

    return Levels(tensors(0, torch.float32), *(tensors(part, torch.int64) for part in (1, 2, 3)))


def _nearest(among: npt.NDArray[Any], points: npt.NDArray[Any], count: int) -> npt.NDArray[np.intp]:
    """(M, min(count, N)) indices of the nearest points in `among` (N, 3), for each of `points` (M, 3)."""
    import small_gicp

    tree = small_gicp.KdTree(np.ascontiguousarray(among, np.float64))
    found, _ = tree.batch_knn_search(np.ascontiguousarray(points, np.float64), min(count, len(among)))
    places: npt.NDArray[np.intp] = np.minimum(found, len(among) - 1).astype(np.intp)
    return places
