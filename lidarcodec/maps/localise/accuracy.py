"""How well the scans of a drive are found in a map: the protocol `track` of evaluation/localisation, with whole scans
and with scans thinned to 2 % of their returns, as Zhang et al. have them ("3D LiDAR map compression for efficient
localization on resource constrained vehicles", 2021).

>>> cloud = np.arange(3000.0).reshape(1000, 3)
>>> len(seen("2 %", cloud, 7))
50
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt

from lidarcodec.evaluation.localisation.errors import pose_errors
from lidarcodec.evaluation.localisation.icp import Schedule, World
from lidarcodec.evaluation.localisation.protocol import judged, lost, track
from lidarcodec.evaluation.rigid import Matrix
from lidarcodec.evaluation.trajectory import voxel_means
from lidarcodec.maps.localise.tracker import CELL_M
from lidarcodec.maps.localise.window import MapWindow
from lidarcodec.maps.world import FEWEST

Scans = Literal["whole", "2 %"]
SCANS: Final[tuple[Scans, ...]] = ("whole", "2 %")
THINNED: Final = 0.02


class WindowWorld:
    """A map in a file for ICP, of which only the tiles around the start are in memory."""

    def __init__(self, window: MapWindow) -> None:
        self._window = window

    def align(self, cloud: Matrix, start: Matrix, stages: Schedule) -> Matrix:
        """(4, 4) T_world_sensor of a cloud (N, 3); `start` where the map has no points. Raises SourceError."""
        world = self._window.around(start[:3, 3])
        return start if world is None else world.align(cloud, start, stages)


def seen(scans: Scans, cloud: Matrix, seed: int) -> Matrix:
    """The returns (N, 3) that the localiser gets: means of cells of 0.5 m, or 2 % of them by lot, at least 50."""
    if scans == "whole":
        return voxel_means(cloud, CELL_M)
    count = max(round(THINNED * len(cloud)), FEWEST)
    return cloud[np.sort(np.random.default_rng(seed).permutation(len(cloud))[:count])]


def accuracy(
    world: World, clouds: Callable[[int], Matrix], poses: Matrix, frames: npt.NDArray[np.intp], seed: int
) -> dict[str, Any]:
    """Errors of a drive's scans in a map. clouds: what the localiser gets of a frame; poses: (F, 4, 4) true ones;
    frames: (T,) those that are looked for, each from where the one before was found.

    of, lost, bad: steps, those off by more than 1 m or 4 degrees, and by more than 0.5 m or 2 degrees
    mate_m, mate_m_error, angle_deg: mean error of the steps that are not bad, and its standard error; null without any
    errors_m, errors_deg: of each step;  lost_steps: their frames
    """
    found = track(world, clouds, poses, frames)
    errors = pose_errors(found, poses[frames])
    judgement = judged("track", errors, seed)
    return {name: judgement[name] for name in ("of", "lost", "bad", "mate_m", "mate_m_error", "angle_deg")} | {
        "p95_m": float(np.percentile(errors["trans_m"], 95)) if len(frames) else None,
        "errors_m": [round(value, 5) for value in errors["trans_m"].tolist()],
        "errors_deg": [round(value, 5) for value in errors["angle_deg"].tolist()],
        "lost_steps": [int(at) for at, one in zip(frames, found, strict=True) if lost(one, poses[at])],
    }
