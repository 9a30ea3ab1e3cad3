"""find_pose: where in a whole map a scan was taken, without any hint.

What stands above the ground is seen from above, in cells of 2 m: houses, poles, rails. The scan's cells are laid over
those of the map at every place and at 72 turns, by correlation with the fast Fourier transform, in blocks of 400 m.
The best places are registered, coarse to fine. The pose counts if enough of the scan lies in the map there, also of
what stands above the ground, and clearly less at every other place, and in every other direction at this place.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import SettingsError
from lidarcodec.evaluation.localisation.icp import Stage
from lidarcodec.evaluation.rigid import Matrix
from lidarcodec.maps.file import TILE_M
from lidarcodec.maps.localise.standing import GROUND_M, above_ground, is_here
from lidarcodec.maps.localise.tracker import FOUND, WIDE, is_good, lying, turned_by
from lidarcodec.maps.localise.window import KEPT_M, Window
from lidarcodec.maps.world import FEWEST, NEAR, Fit

CELL_M: Final = 2.0
TURNS: Final = 72
BLOCK: Final = 8
"""Width of a block in tiles. Blocks overlap by the reach of a scan."""
REACH_M: Final = 60.0
"""Farther returns are too far apart."""
LEAST_CELLS: Final = 20
BEST_OF_BLOCK: Final = 24
TRIED: Final = 48
APART_M: Final = 4.0
APART_RAD: Final = 3 * 2 * np.pi / TURNS
CLEARLY: Final = 0.85
"""In another pose at most this share of what lies in the map in the best one may lie there."""
ELSEWHERE_M: Final = 3.0
NEAR_START_M: Final = 15.0
USUAL_HEIGHT_M: Final = 1.8
ROUNDS: Final = (
    (400, (Stage(5.0, 6, 1, 0.02), Stage(2.0, 6, 1, 0.02)), 12),
    (1200, (Stage(2.0, 8, 1, 0.02), *NEAR), 12),
)
"""Points of the scan, stages, and number of places that are kept, in each round of registration."""
Grid = npt.NDArray[np.float32]


class Candidate(NamedTuple):
    """A place of the scan in the map: score up to 1, x, y in metres, yaw in radians, height z of the ground."""

    score: float
    x: float
    y: float
    yaw: float
    z: float


def find_pose(
    window: Window, cloud: Matrix, stop: Callable[[], bool] = lambda: False, tick: Callable[[], None] = lambda: None
) -> Fit | None:
    """The scan of a cloud (N, 3) registered in the map; None if it is found nowhere, or in several poses.

    stop: asked between two steps of less than a second, whether to give up; tick: called after each block
    Raises SourceError for a map that is too dense.
    """
    cells, height_m = _cells_of(cloud)
    if len(cells) < LEAST_CELLS:
        return None
    found: list[Candidate] = []
    for block in _blocks(window):
        if stop():
            return None
        found += _in_block(window, block, cells)
        tick()
    starts = []
    for candidate in _apart(found)[:TRIED]:
        start = turned_by(np.degrees(candidate.yaw))
        start[:3, 3] = candidate.x, candidate.y, candidate.z + height_m
        starts.append(start)
    for few, stages, kept in ROUNDS:
        starts.sort(key=lambda start: (*np.floor(start[:2, 3] / KEPT_M),))  # the window moves less often
        fits = []
        part = cloud[np.random.default_rng(3).permutation(len(cloud))[:few]]
        for start in starts:
            if stop():
                return None
            world = window.around(start[:3, 3])
            if world is not None:
                fits.append(world.fit(part, start, stages))
        fits.sort(key=lambda fit: -lying(fit))
        starts = [fit.pose for fit in _different(fits)][:kept]
    return _clear(window, cloud, _different(fits))


def _different(fits: list[Fit]) -> list[Fit]:
    """Fits without those that ended in the pose of a better one. In a symmetric place another direction is another."""
    kept: list[Fit] = []
    for fit in fits:
        if not any(_same(fit.pose, other.pose) for other in kept):
            kept.append(fit)
    return kept


def _same(one: Matrix, other: Matrix) -> bool:
    yaws = [float(np.arctan2(pose[1, 0], pose[0, 0])) for pose in (one, other)]
    return bool(np.linalg.norm(one[:3, 3] - other[:3, 3]) <= ELSEWHERE_M and _turn(*yaws) < APART_RAD)


def _turn(one: float, other: float) -> float:
    """The angle between two yaws, in radians."""
    return abs((one - other + np.pi) % (2 * np.pi) - np.pi)


def standing_at(window: Window, x: float, y: float) -> Matrix:
    """(4, 4) a level pose at a place of the map, as high above the ground as sensors of cars are.

    Raises SettingsError if the map has no points there.
    """
    place = np.array([x, y])
    points = window.points(place - NEAR_START_M, place + NEAR_START_M).xyz
    near = points[np.einsum("ij,ij->i", points[:, :2] - place, points[:, :2] - place) < NEAR_START_M**2]
    if not len(near):
        raise SettingsError(
            f"the map has no points within {NEAR_START_M:.0f} m of {x:g}, {y:g}: `map info` says which area it covers",
            "start",
        )
    pose = np.eye(4)
    pose[:3, 3] = x, y, _ground(near) + USUAL_HEIGHT_M
    return pose


def _clear(window: Window, cloud: Matrix, fits: list[Fit]) -> Fit | None:
    """The best fit with all of the cloud, if it is good and no other pose is nearly as good."""
    if not fits or (len(fits) > 1 and lying(fits[1]) > CLEARLY * lying(fits[0])):
        return None
    world = window.around(fits[0].pose[:3, 3])
    if world is None:
        return None
    best = world.fit(cloud, fits[0].pose, WIDE)
    return best if is_good(best, FOUND) and is_here(world, cloud, best) else None


def _cells_of(cloud: Matrix) -> tuple[Matrix, float]:
    """(K, 2) metres, cells of a scan with something above the ground, seen from above; height of the sensor."""
    near = cloud[np.einsum("ij,ij->i", cloud[:, :2], cloud[:, :2]) < REACH_M**2]
    if len(near) < FEWEST:
        return np.empty((0, 2)), 0.0
    standing = near[above_ground(near)]
    cells = np.unique(np.floor(standing[:, :2] / (CELL_M / 2)), axis=0)
    around = near[np.einsum("ij,ij->i", near[:, :2], near[:, :2]) < 15.0**2]
    return (cells + 0.5) * (CELL_M / 2), -_ground(around if len(around) >= FEWEST else near)


def _ground(points: Matrix) -> float:
    return float(np.percentile(points[:, 2], 10))


def _blocks(window: Window) -> Iterator[tuple[int, int]]:
    yield from sorted({(x // BLOCK, y // BLOCK) for x, y in window.places})


def _in_block(window: Window, block: tuple[int, int], cells: Matrix) -> list[Candidate]:
    """The best places in a block of tiles."""
    inner = np.array(block) * BLOCK * TILE_M
    low, high = inner - REACH_M, inner + BLOCK * TILE_M + REACH_M
    points = window.points(low, np.nextafter(high, low)).xyz
    if len(points) < FEWEST:
        return []
    low = np.maximum(low, points[:, :2].min(axis=0) - CELL_M)
    high = np.minimum(high, points[:, :2].max(axis=0) + CELL_M)
    points = points[((points[:, :2] >= low) & (points[:, :2] < high)).all(axis=1)]
    if len(points) < FEWEST:
        return []
    shape = np.ceil((high - low) / CELL_M).astype(int) + 1
    standing = points[above_ground(points)]
    grid = np.zeros(shape, np.float32)
    at = ((standing[:, :2] - low) / CELL_M).astype(int)
    grid[at[:, 0], at[:, 1]] = 1.0
    size = [1 << int(length + 2 * REACH_M / CELL_M).bit_length() for length in shape]
    spectrum = np.fft.rfft2(_blurred(grid), size)
    scores = np.full((TURNS, *shape), -1.0, np.float32)
    for turn in range(TURNS):
        scores[turn] = _correlated(spectrum, size, cells, turn)[: shape[0], : shape[1]]
    heights = _heights(points, low, shape)
    return _peaks(scores, low, inner, heights)


def _correlated(spectrum: npt.NDArray[np.complexfloating], size: list[int], cells: Matrix, turn: int) -> Grid:
    """(X, Y) share of a scan's cells that meet the map, for the sensor in the middle of each cell."""
    yaw = 2 * np.pi * turn / TURNS
    turned = np.floor(
        np.stack([cells[:, 0] * np.cos(yaw) - cells[:, 1] * np.sin(yaw),
                  cells[:, 0] * np.sin(yaw) + cells[:, 1] * np.cos(yaw)], axis=1) / CELL_M + 0.5
    ).astype(int)  # fmt: skip
    kernel = np.zeros(size, np.float32)
    kernel[turned[:, 0] % size[0], turned[:, 1] % size[1]] = 1.0
    found: Grid = (np.fft.irfft2(spectrum * np.conj(np.fft.rfft2(kernel)), size) / kernel.sum()).astype(np.float32)
    return found


def _blurred(grid: Grid) -> Grid:
    """Each cell with half of the largest value around it, if that is more."""
    padded = np.pad(grid, 1)
    around = grid.copy()
    for x in (0, 1, 2):
        for y in (0, 1, 2):
            shifted = padded[x : x + grid.shape[0], y : y + grid.shape[1]]
            np.maximum(around, 0.5 * shifted, out=around, casting="same_kind")
    return around


def _heights(points: Matrix, low: Matrix, shape: npt.NDArray[np.int_]) -> Matrix:
    """(X, Y) height of the ground in cells of GROUND_M * 2, where it is not known the median."""
    wide = 2 * GROUND_M
    cells = ((points[:, :2] - low) / wide).astype(int)
    count = np.ceil(shape * CELL_M / wide).astype(int) + 1
    lowest = np.full(count, np.inf)
    np.minimum.at(lowest, (cells[:, 0], cells[:, 1]), points[:, 2])
    usual = float(np.median(lowest[np.isfinite(lowest)]))
    lowest[~np.isfinite(lowest)] = usual
    return lowest


def _peaks(scores: Grid, low: Matrix, inner: Matrix, heights: Matrix) -> list[Candidate]:
    """The best places of a block; its border belongs to other blocks."""
    xs, ys = (low[axis] + (np.arange(scores.shape[axis + 1]) + 0.5) * CELL_M for axis in (0, 1))
    outside = (xs < inner[0]) | (xs >= inner[0] + BLOCK * TILE_M)
    scores[:, outside] = -1.0
    scores[:, :, (ys < inner[1]) | (ys >= inner[1] + BLOCK * TILE_M)] = -1.0
    flat = scores.ravel()
    most = min(flat.size, 20 * BEST_OF_BLOCK)
    order = np.argpartition(flat, -most)[-most:]
    wide = 2 * GROUND_M
    found = []
    for at in order[np.argsort(-flat[order])]:
        turn, x, y = np.unravel_index(at, scores.shape)
        ground = heights[int((xs[x] - low[0]) / wide), int((ys[y] - low[1]) / wide)]
        found.append(
            Candidate(float(flat[at]), float(xs[x]), float(ys[y]), 2 * np.pi * float(turn) / TURNS, float(ground))
        )
    return _apart(found)[:BEST_OF_BLOCK]


def _apart(found: list[Candidate]) -> list[Candidate]:
    """Candidates from the best on, without those that are near a better one."""
    kept: list[Candidate] = []
    for one in sorted(found, reverse=True):
        for other in kept:
            away = (one.x - other.x) ** 2 + (one.y - other.y) ** 2
            if away < APART_M**2 and _turn(one.yaw, other.yaw) < APART_RAD:
                break
        else:
            kept.append(one)
    return kept
