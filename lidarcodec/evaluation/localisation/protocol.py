"""Localisation tests: tracking as in the paper, bad starts, and near starts.

track    every third scan, at equal intervals. It starts from the previous estimate, without a motion model. An
         estimate off by more than 1 m or 4 degrees is lost: it is counted, and the next one starts at the true pose.
         Mean errors are over steps within 0.5 m and 2 degrees
starts   the start is off by 2 m in any direction and 5 degrees of yaw; found if within 0.2 m and 0.5 degrees
near     the start is off by 0.5 m and 1 degree, with fine stages only. This shows the error due to the cloud. Mean
         errors are over estimates within 0.3 m and 1 degree; the others are counted as bad
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt

from lidarcodec.evaluation.localisation.errors import pose_errors, summary
from lidarcodec.evaluation.localisation.icp import COARSE, FINE, World
from lidarcodec.evaluation.localisation.reference import pose_of
from lidarcodec.evaluation.rigid import Matrix
from lidarcodec.evaluation.trajectory import MAP_EVERY

Protocol = Literal["track", "starts", "near"]
PROTOCOLS: Final[tuple[Protocol, ...]] = ("track", "starts", "near")
LOST: Final = (1.0, 4.0)
"""Metres, degrees."""
COUNTED: Final = {"track": (0.5, 2.0), "starts": (0.2, 0.5), "near": (0.3, 1.0)}
START_EVERY: Final = 9
STARTS: Final = 2
"""Number of bad starts for each of these scans."""
Clouds = Callable[[int], Matrix]


@dataclass(frozen=True)
class Scored:
    """Frames to localise, and frames of the map; no frame is in both. tracked: (T,); started: (S,); mapped: (M,)"""

    tracked: npt.NDArray[np.intp]
    started: npt.NDArray[np.intp]
    mapped: npt.NDArray[np.intp]

    @property
    def all(self) -> list[int]:
        """All frames to localise, in order."""
        return sorted({*self.tracked.tolist(), *self.started.tolist()})


def scored_frames(count: int, stride: int) -> Scored:
    """For a drive of `count` frames: every `stride`-th frame is tracked, every ninth one gets bad starts, every
    fifth one is in the map.

    If a frame would be both tracked and mapped, the map gets the next frame, so a step of the track is always `stride`
    frames. Only if every frame is tracked (`stride` 1), the frames of the map are not tracked. If a frame with bad
    starts is in the map, the next frame is used instead."""
    tracked = np.arange(1, count - 1, stride)
    mapped = np.arange(0, count, MAP_EVERY)
    if stride > 1:
        mapped = np.where(np.isin(mapped, tracked), mapped + 1, mapped)
    started = np.arange(4, count - 1, START_EVERY)
    started = np.where(np.isin(started, mapped), started + 1, started)
    return Scored(np.setdiff1d(tracked, mapped), np.setdiff1d(started, mapped), mapped)


def track(world: World, clouds: Clouds, poses: Matrix, frames: npt.NDArray[np.intp]) -> Matrix:
    """(T, 4, 4) estimates, each started from the previous one, or from the true pose after a lost one."""
    found = np.empty((len(frames), 4, 4))
    start = poses[max(int(frames[0]) - 1, 0)] if len(frames) else np.eye(4)
    for step, at in enumerate(frames):
        found[step] = world.align(clouds(int(at)), start, COARSE)
        start = poses[at] if lost(found[step], poses[at]) else found[step]
    return found


def lost(estimate: Matrix, reference: Matrix) -> bool:
    """Whether tracking has lost the position."""
    return not _within(pose_errors(estimate[None], reference[None]), *LOST)[0]


def from_starts(world: World, clouds: Clouds, poses: Matrix, frames: npt.NDArray[np.intp], seed: int) -> Matrix:
    """(S * STARTS, 4, 4) estimates from starts that are off by 2 m and 5 degrees."""
    random = np.random.default_rng((seed, 1))
    found = [
        world.align(clouds(int(at)), poses[at] @ _off(random, 2.0, 5.0), COARSE) for at in frames for _ in range(STARTS)
    ]
    return np.array(found).reshape(-1, 4, 4)


def from_near(world: World, clouds: Clouds, poses: Matrix, frames: npt.NDArray[np.intp], seed: int) -> Matrix:
    """(T, 4, 4) estimates from starts that are off by 0.5 m and 1 degree, with the fine stages."""
    random = np.random.default_rng((seed, 2))
    found = [world.align(clouds(int(at)), poses[at] @ _off(random, 0.5, 1.0), FINE) for at in frames]
    return np.array(found).reshape(-1, 4, 4)


def run(protocol: Protocol, world: World, clouds: Clouds, poses: Matrix, scored: Scored, seed: int) -> Matrix:
    """(N, 4, 4) estimates of a protocol."""
    if protocol == "track":
        return track(world, clouds, poses, scored.tracked)
    if protocol == "starts":
        return from_starts(world, clouds, poses, scored.started, seed)
    return from_near(world, clouds, poses, scored.tracked, seed)


def references(protocol: str, poses: Matrix, scored: Scored) -> Matrix:
    """The true poses of a protocol's estimates."""
    return poses[np.repeat(scored.started, STARTS)] if protocol == "starts" else poses[scored.tracked]


def judged(protocol: str, errors: dict[str, Matrix], seed: int) -> dict[str, Any]:
    """Results of one protocol on one drive: means of `errors.summary`, number of estimates `of`, and number of
    failures.
    """
    counted = _within(errors, *COUNTED[protocol])
    result = {"of": len(counted), **summary(errors, counted, seed)}
    result["median_m"] = float(np.median(errors["trans_m"])) if len(counted) else None
    if protocol == "track":
        result["lost"] = int(np.count_nonzero(~_within(errors, *LOST)))
    if protocol == "starts":
        result["found"] = float(counted.mean()) if len(counted) else None
    else:
        result["bad"] = int(np.count_nonzero(~counted))
    return result


def counted_errors(protocol: str, errors: dict[str, Matrix]) -> Matrix:
    """(K,) errors in metres that count for the mean."""
    metres: Matrix = errors["trans_m"][_within(errors, *COUNTED[protocol])]
    return metres


def _within(errors: dict[str, Matrix], metres: float, degrees: float) -> npt.NDArray[np.bool_]:
    near: npt.NDArray[np.bool_] = (errors["trans_m"] <= metres) & (errors["angle_deg"] <= degrees)
    return near


def _off(random: np.random.Generator, metres: float, degrees: float) -> Matrix:
    way = random.uniform(0, 2 * np.pi)
    yaw = np.radians(degrees) * random.choice((-1.0, 1.0))
    return pose_of(np.array([0.0, 0.0, yaw]), metres * np.array([np.cos(way), np.sin(way), 0.0]))
