"""How a place is looked for: tracking as the paper does it, from bad starts, and from near by.

track    every third scan, all of them as far apart, from where the one before was found, with no model of motion. Off
         by more than 1 m or 4 degrees is lost: counted, and put back on the path. Errors are those of steps within
         0.5 m and 2 degrees
starts   2 m in any direction and 5 degrees of yaw off; found when within 0.2 m and 0.5 degrees
near     0.5 m and 1 degree off, with fine stages only: the error that the cloud itself makes. Errors are those
         within 0.3 m and 1 degree, the others are counted as bad
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
"""Bad starts for each of those scans."""
Clouds = Callable[[int], Matrix]


@dataclass(frozen=True)
class Scored:
    """Which frames are looked for, and which the map is made of; none is both. tracked: (T,); started: (S,); mapped:
    (M,)"""

    tracked: npt.NDArray[np.intp]
    started: npt.NDArray[np.intp]
    mapped: npt.NDArray[np.intp]

    @property
    def all(self) -> list[int]:
        """Every frame that is looked for, in order."""
        return sorted({*self.tracked.tolist(), *self.started.tolist()})


def scored_frames(count: int, stride: int) -> Scored:
    """Of a drive of `count` frames: every `stride`-th is tracked, every ninth looked for from bad starts, every fifth
    in the map.

    Where a scan would be tracked and mapped, the map takes the next one: a step of the track is `stride` scans, never
    more. Only where every scan is tracked (`stride` 1) those of the map are left out. What is looked for from bad
    starts moves on by one where it is in the map."""
    tracked = np.arange(1, count - 1, stride)
    mapped = np.arange(0, count, MAP_EVERY)
    if stride > 1:
        mapped = np.where(np.isin(mapped, tracked), mapped + 1, mapped)
    started = np.arange(4, count - 1, START_EVERY)
    started = np.where(np.isin(started, mapped), started + 1, started)
    return Scored(np.setdiff1d(tracked, mapped), np.setdiff1d(started, mapped), mapped)


def track(world: World, clouds: Clouds, poses: Matrix, frames: npt.NDArray[np.intp]) -> Matrix:
    """(T, 4, 4) estimates, each started from the one before; a lost one is followed by the true pose."""
    found = np.empty((len(frames), 4, 4))
    start = poses[max(int(frames[0]) - 1, 0)] if len(frames) else np.eye(4)
    for step, at in enumerate(frames):
        found[step] = world.align(clouds(int(at)), start, COARSE)
        start = poses[at] if lost(found[step], poses[at]) else found[step]
    return found


def lost(estimate: Matrix, reference: Matrix) -> bool:
    """Whether tracking has lost its way."""
    return not _within(pose_errors(estimate[None], reference[None]), *LOST)[0]


def from_starts(world: World, clouds: Clouds, poses: Matrix, frames: npt.NDArray[np.intp], seed: int) -> Matrix:
    """(S * STARTS, 4, 4) estimates from 2 m and 5 degrees off."""
    random = np.random.default_rng((seed, 1))
    found = [
        world.align(clouds(int(at)), poses[at] @ _off(random, 2.0, 5.0), COARSE) for at in frames for _ in range(STARTS)
    ]
    return np.array(found).reshape(-1, 4, 4)


def from_near(world: World, clouds: Clouds, poses: Matrix, frames: npt.NDArray[np.intp], seed: int) -> Matrix:
    """(T, 4, 4) estimates from 0.5 m and 1 degree off, with the fine stages."""
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
    """What came of one protocol on one drive: means of `errors.summary`, `of` how many, and how many went wrong."""
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
    """(K,) metres, of those that count for the mean."""
    metres: Matrix = errors["trans_m"][_within(errors, *COUNTED[protocol])]
    return metres


def _within(errors: dict[str, Matrix], metres: float, degrees: float) -> npt.NDArray[np.bool_]:
    near: npt.NDArray[np.bool_] = (errors["trans_m"] <= metres) & (errors["angle_deg"] <= degrees)
    return near


def _off(random: np.random.Generator, metres: float, degrees: float) -> Matrix:
    way = random.uniform(0, 2 * np.pi)
    yaw = np.radians(degrees) * random.choice((-1.0, 1.0))
    return pose_of(np.array([0.0, 0.0, yaw]), metres * np.array([np.cos(way), np.sin(way), 0.0]))
