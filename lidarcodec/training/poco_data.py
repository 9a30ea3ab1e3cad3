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


class PocoReturns(NamedTuple):
    """All R returns of a frame, in the order of its cloud. features: (R, 4) float32, x y z in metres and intensity /
    255; labels: (R,) uint8, 0 low, 1 high, 2 ground."""

    features: npt.NDArray[np.float32]
    labels: npt.NDArray[np.uint8]


class PocoScan(NamedTuple):
    """points: (N, 3) float32, metres; features: (N, 4) float32, x y z and intensity / 255; labels: (N,) int64, 0 low,
    1 high, 2 ground; near: (N, 12) intp, neighbours of each of the points."""

    points: npt.NDArray[np.float32]
    features: npt.NDArray[np.float32]
    labels: npt.NDArray[np.int64]
    near: npt.NDArray[np.intp]


class Levels(NamedTuple):
    """The arguments of PocoNet besides the features, one tensor for each stage."""

    points: list[Tensor]
    near: list[Tensor]
    kept: list[Tensor]
    up: list[Tensor]


def poco_returns(frame: Frame, truth: Labels | None) -> PocoReturns:
    """The returns of a frame; labels are 0 without `truth`."""
    cloud = frame.cloud()
    intensity = cloud["intensity"].astype(np.float32) / 255
    features = np.stack([*(cloud[axis] for axis in "xyz"), intensity], axis=1)
    labels = np.zeros(len(cloud), np.uint8) if truth is None else truth.labels.T[frame.valid.T] - np.uint8(1)
    return PocoReturns(features, labels)


def poco_scan(returns: PocoReturns, count: int, rng: np.random.Generator) -> PocoScan | None:
    """`count` of a frame's returns; None if it has none."""
    if not len(returns.features):
        return None
    chosen = rng.permutation(len(returns.features))[:count]
    if len(chosen) < count:
        chosen = np.append(chosen, rng.choice(len(returns.features), count - len(chosen)))
    features = returns.features[chosen]
    points = np.ascontiguousarray(features[:, :3])
    return PocoScan(points, features, returns.labels[chosen].astype(np.int64), _nearest(points, points, NEIGHBOURS))


def lent(scan: PocoScan, returns: PocoReturns) -> npt.NDArray[np.intp]:
    """(R,) for each return of a frame the nearest one of those in `scan`, which lends it what was found."""
    return _nearest(scan.points, returns.features[:, :3], 1)[:, 0]


def levels_of(scans: Sequence[PocoScan], rng: np.random.Generator, device: torch.device) -> Levels:
    """One random sampling for a batch of scans with equal numbers of points."""
    stacked: list[list[tuple[npt.NDArray[Any], ...]]] = [[] for _ in STAGES]
    for scan in scans:
        points, near = scan.points, scan.near
        for stage in stacked:
            kept = rng.permutation(len(points))[: max(len(points) // QUARTER, 1)]
            stage.append((points.T, near, kept, _nearest(points[kept], points, 1)[:, 0]))
            points = points[kept]
            if stage is not stacked[-1]:
                near = _nearest(points, points, NEIGHBOURS)

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
