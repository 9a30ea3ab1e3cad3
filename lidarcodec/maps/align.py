"""aligned: where a drive lies in a map of other drives, by their overlap.

Some scans of the drive are searched in the map (localise/search.py), spread over its way, until three say the same of
where the drive lies. Then all of its samples are registered in the map from there. Of those that lie in the map nearly
all must fit, over a length of the way, and say the same to a few centimetres. Otherwise there is no alignment: a false
one would spoil the map.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Final, NamedTuple

import numpy as np

from lidarcodec.errors import SourceError
from lidarcodec.evaluation.rigid import Matrix, exp_so3, invert, log_so3, moved
from lidarcodec.evaluation.trajectory import voxel_means
from lidarcodec.maps.localise.search import find_pose, standing_at
from lidarcodec.maps.localise.standing import STANDING, standing_share
from lidarcodec.maps.localise.tracker import CELL_M, FOUND, TURNS_DEG, WIDE, is_good, lying, turned_by
from lidarcodec.maps.localise.window import Window
from lidarcodec.maps.world import Fit, inverse

SPACING_M: Final = 1.0
MOST_SAMPLES: Final = 96
"""When there are more, every second one is left out, and their distance is doubled."""
MOST_SEARCHED: Final = 32
AGREEING: Final = 3
"""Scans found by a search that say the same of where the drive lies."""
NEAR_M, NEAR_SHARE, NEAR_RAD = 1.0, 0.01, np.radians(2.0)
"""They say the same to a metre and a hundredth of the way between them, because the poses of a drive drift."""
INSIDE_M: Final = 10.0
"""A scan lies in the map if a drive of the map came so near. Farther out the map is of far returns, which err more."""
FITTING: Final = 0.8
"""Least share, of the samples that lie in the map, of those that fit."""
FEWEST: Final = 5
LEAST_M: Final = 10.0
"""Least distance between two samples that fit."""
MOST_APART_M, MOST_APART_DEG = 0.25, 0.5
"""Largest rms deviation of the samples from one alignment."""
OWN_ERROR: Final = (0.03, np.radians(0.1))
"""Metres and radians by which a single fit errs, beside what its covariance says."""
ROUNDS: Final = 8
Tick = Callable[[], None]


class WeakOverlapError(SourceError):
    """A drive does not overlap enough with the map, or does not fit it."""


class Sample(NamedTuple):
    """A scan of a drive. cloud: (N, 3) relative to the sensor, along the axes of the drive; place, yaw_deg: of the
    sensor in the frame of the drive"""

    cloud: Matrix
    place: Matrix
    yaw_deg: float


class Tried(NamedTuple):
    """A registered sample. standing: share of its returns above the ground that lie in the map"""

    sample: Sample
    fit: Fit
    standing: float


class Alignment(NamedTuple):
    """Where a drive lies in a map.

    transform: (4, 4) T_map_drive
    scans, of: number of samples that fit, and of those that lie in the map
    overlap: share of all samples that lie in the map
    residual_m, residual_deg: rms deviation of the samples that fit
    """

    transform: Matrix
    scans: int
    of: int
    overlap: float
    residual_m: float
    residual_deg: float


def samples_of(scans: Iterable[tuple[Matrix, Matrix]], tick: Tick = lambda: None) -> list[Sample]:
    """Scans of a drive, spread over its way, at most 96. scans: points (N, 3) in the drive's frame, and the sensor's
    pose (4, 4) there"""
    found: list[Sample] = []
    spacing_m = SPACING_M
    for points, pose in scans:
        place = pose[:3, 3].copy()
        if not found or np.linalg.norm(place - found[-1].place) >= spacing_m:
            yaw_deg = float(np.degrees(np.arctan2(pose[1, 0], pose[0, 0])))
            found.append(Sample(voxel_means(points - place, CELL_M), place, yaw_deg))
        if len(found) > MOST_SAMPLES:
            found, spacing_m = found[::2], 2 * spacing_m
        tick()
    return found


def aligned(
    window: Window,
    path: Matrix,
    samples: Sequence[Sample],
    start: tuple[float, float, float] | None = None,
    tick: Tick = lambda: None,
) -> Alignment:
    """Where a drive lies in a map.

    path: (P, 3) where the sensors of the map were, about one place a metre
    start: x, y in metres and yaw in degrees of its first scan there, if it is known

    Raises WeakOverlapError, SourceError for a map that is too dense, SettingsError for a start without points around.
    """
    if len(samples) < FEWEST or _length_m(samples) < LEAST_M:
        raise WeakOverlapError(f"it leads over less than {LEAST_M:g} m")
    transform = _searched(window, samples, tick) if start is None else _started(window, samples[0], start)
    for _ in range(2):
        inside = [sample for sample in samples if _is_inside(sample, transform, path)]
        fitting = [one for sample in inside if _fits(one := _fit(window, sample, transform), transform)]
        tick()
        _check(fitting, len(inside))
        transform = _mean(fitting, transform)
    apart = np.stack([_apart(one, transform) for one in fitting])
    metres, radians = (
        float(np.sqrt(np.einsum("ij,ij->i", part, part).mean())) for part in (apart[:, :3], apart[:, 3:])
    )
    degrees = float(np.degrees(radians))
    if metres > MOST_APART_M or degrees > MOST_APART_DEG:
        raise WeakOverlapError(f"its poses and theirs bend apart by {metres:.2f} m and {degrees:.2f} degrees")
    return Alignment(transform, len(fitting), len(inside), len(inside) / len(samples), metres, degrees)


def _searched(window: Window, samples: Sequence[Sample], tick: Tick) -> Matrix:
    """(4, 4) T_map_drive, as three scans say it that were found without a start."""
    order = sorted(range(len(samples)), key=lambda at: f"{at:08b}"[::-1])  # the way is halved again and again
    found: list[tuple[Sample, Matrix]] = []
    for at in order[:MOST_SEARCHED]:
        sample = samples[at]
        fit = find_pose(window, sample.cloud, tick=tick)
        if fit is None:
            continue
        found.append((sample, _drive_by(sample, fit)))
        agreeing = [one for one in found if _same(one, found[-1])]
        if len(agreeing) >= AGREEING:
            return found[-1][1]
    searched = min(len(order), MOST_SEARCHED)
    what = "none" if not found else f"{len(found)}, which do not say the same,"
    raise WeakOverlapError(f"of {searched} of its scans {what} could be found in their map")


def _same(one: tuple[Sample, Matrix], other: tuple[Sample, Matrix]) -> bool:
    """Whether two scans say the same of where their drive lies."""
    places = np.stack([one[0].place, other[0].place])
    off = np.linalg.norm(moved(one[1], places) - moved(other[1], places), axis=1).max()
    turn = np.linalg.norm(log_so3((one[1][:3, :3] @ other[1][:3, :3].T)[None])[0])
    return bool(off <= NEAR_M + NEAR_SHARE * np.linalg.norm(places[0] - places[1]) and turn <= NEAR_RAD)


def _started(window: Window, sample: Sample, start: tuple[float, float, float]) -> Matrix:
    """(4, 4) T_map_drive, from where the first scan is said to be."""
    x, y, yaw_deg = start
    pose = standing_at(window, x, y) @ turned_by(yaw_deg - sample.yaw_deg)
    world = window.around(pose[:3, 3])
    fits = [] if world is None else [world.fit(sample.cloud, pose @ turned_by(turn), WIDE) for turn in TURNS_DEG]
    best = max(fits, key=lying, default=None)
    if best is None or not is_good(best, FOUND):
        raise WeakOverlapError(f"its first scan does not fit their map at {x:g},{y:g},{yaw_deg:g}")
    return _drive_by(sample, best)


def _drive_by(sample: Sample, fit: Fit) -> Matrix:
    """(4, 4) T_map_drive as one registered sample says it."""
    back = np.eye(4)
    back[:3, 3] = -sample.place
    found: Matrix = fit.pose @ back
    return found


def _expected(sample: Sample, transform: Matrix) -> Matrix:
    place = np.eye(4)
    place[:3, 3] = sample.place
    pose: Matrix = transform @ place
    return pose


def _is_inside(sample: Sample, transform: Matrix, path: Matrix) -> bool:
    off = path[:, :2] - moved(transform, sample.place[None])[0, :2]
    return bool(np.einsum("ij,ij->i", off, off).min(initial=np.inf) < INSIDE_M**2)


def _fit(window: Window, sample: Sample, transform: Matrix) -> Tried:
    """A sample registered from where the transform has it. Outside of the map it fits nothing."""
    pose = _expected(sample, transform)
    world = window.around(pose[:3, 3])
    if world is None:
        return Tried(sample, Fit(pose, np.full((6, 6), np.inf), 0.0, 0.0, 0), 0.0)
    fit = world.fit(sample.cloud, pose, WIDE)
    return Tried(sample, fit, standing_share(world, sample.cloud, fit.pose))


def _fits(tried: Tried, transform: Matrix) -> bool:
    apart = _apart(tried, transform)
    near = np.linalg.norm(apart[:3]) <= NEAR_M and np.linalg.norm(apart[3:]) <= NEAR_RAD
    return bool(near and tried.standing >= STANDING and is_good(tried.fit, FOUND))


def _apart(tried: Tried, transform: Matrix) -> Matrix:
    """(6,) position in metres and rotation vector of a registered sample, from where the transform has it."""
    fit, pose = tried.fit, _expected(tried.sample, transform)
    turn = fit.pose[:3, :3] @ pose[:3, :3].T
    apart: Matrix = np.concatenate([fit.pose[:3, 3] - pose[:3, 3], log_so3(turn[None])[0]])
    return apart


def _check(fitting: Sequence[Tried], inside: int) -> None:
    """Raise WeakOverlapError if too few samples fit, too few of those in the map, or over too short a way."""
    if len(fitting) < FEWEST or len(fitting) < FITTING * inside:
        raise WeakOverlapError(f"only {len(fitting)} of {inside} scans that lie in their map fit it")
    if _length_m([one.sample for one in fitting]) < LEAST_M:
        raise WeakOverlapError(f"its scans fit their map over less than {LEAST_M:g} m")


def _length_m(samples: Sequence[Sample]) -> float:
    """The largest distance of a sample from the first one."""
    places = np.stack([sample.place for sample in samples])
    return float(np.linalg.norm(places - places[0], axis=1).max())


def _mean(fitting: Sequence[Tried], transform: Matrix) -> Matrix:
    """The transform that all samples say together, weighted by their covariances, by Gauss and Newton."""
    own = np.diag([OWN_ERROR[0] ** 2] * 3 + [OWN_ERROR[1] ** 2] * 3)
    weights = [inverse(one.fit.covariance + own) for one in fitting]
    middle = np.stack([one.fit.pose[:3, 3] for one in fitting]).mean(axis=0)
    for _ in range(ROUNDS):
        system, slope = np.zeros((6, 6)), np.zeros(6)
        for one, weight in zip(fitting, weights, strict=True):
            off = _apart(one, transform)
            x, y, z = one.fit.pose[:3, 3] - off[:3] - middle
            slopes = np.eye(6)
            slopes[:3, 3:] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
            far = float(np.sqrt(off @ weight @ off))
            robust = weight / max(far / 3.0, 1.0)
            system += slopes.T @ robust @ slopes
            slope += slopes.T @ robust @ off
        step: Matrix = np.linalg.solve(system, slope).astype(np.float64)
        turn = np.eye(4)
        turn[:3, :3] = exp_so3(step[3:])
        there = np.eye(4)
        there[:3, 3] = middle
        back: Matrix = there @ turn @ invert(there) @ transform
        back[:3, 3] += step[:3]
        transform = back
    return transform
