"""Evidence for a place: how much better what stands above the ground lies in the map there than a few metres farther.

The ground fits anywhere along a road, and rails do, too. So a place is compared with rivals: places 1.5 to 4.5 m away
along the direction in which its pose is least certain, each registered with that direction held. Of the same returns,
the rivals explain what says nothing, and cars that were not there explain nothing anywhere. What is left speaks for the
place. In another town, or beside the right place, nothing is left.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from lidarcodec.evaluation.localisation.icp import Stage
from lidarcodec.evaluation.rigid import Matrix, moved
from lidarcodec.maps.localise.standing import above_ground
from lidarcodec.maps.world import CLOSE_M, INFLATED, MapWorld, Prior

RIVALS_M: Final = (1.5, 3.0, 4.5)
"""How far away rivals are, on either side."""
NEAREST: Final = 0.25
"""Shift by which it is measured how fast the likelihood falls."""
STRAY: Final = 0.1
"""Likelihood of a return that lies on nothing in the map, against one that lies on it."""
MOST_STANDING: Final = 1000
MOST_GROUND: Final = 700
"""Returns that are used of a scan, to save time."""
HELD: Final = 1e6
"""Information, in 1/m^2, that holds a rival where it is."""
SETTLE: Final = (Stage(1.0, 4, 1, 0.01),)


class Evidence(NamedTuple):
    """Of one scan or of several, in nats, as if all returns erred by themselves.

    gain: how much likelier the scan is than at the rivals; lead: than at the best of them
    possible: the gain if all that stands lay in the map; fall: how much less likely it is NEAREST metres away
    """

    gain: float
    lead: float
    possible: float
    fall: float

    def and_then(self, other: Evidence, kept: float = 1.0) -> Evidence:
        """The sum with that of another scan; kept: weight of what was before."""
        return Evidence(*(kept * one + two for one, two in zip(self, other, strict=True)))

    @property
    def share(self) -> float:
        """Part of what could speak for the place that does."""
        return self.gain / self.possible if self.possible > 0 else 0.0

    @property
    def variance(self) -> float:
        """Variance of the place, in square metres, in the direction of the rivals."""
        return INFLATED * NEAREST**2 / (2 * self.fall) if self.fall > 0 else np.inf


NONE: Final = Evidence(0.0, 0.0, 0.0, 0.0)


class Seen(NamedTuple):
    """Returns of a scan in the sensor's frame. all: (N, 3) those to register; standing: (M, 3) above the ground"""

    all: Matrix
    standing: Matrix


def seen_from(cloud: Matrix, pose: Matrix) -> Seen:
    """Some of the returns of a cloud (N, 3) near a pose (4, 4)."""
    if not len(cloud):
        return Seen(cloud, cloud)
    above = above_ground(moved(pose, cloud))
    standing, ground = _some(cloud[above], MOST_STANDING), _some(cloud[~above], MOST_GROUND)
    return Seen(np.concatenate([standing, ground]), standing)


def support(world: MapWorld, standing: Matrix, pose: Matrix) -> float:
    """Log likelihood of what stands at a pose, over that of returns that lie on nothing."""
    if not len(standing):
        return 0.0
    off = world.off_planes(standing, pose)
    return float(np.log1p((1 / STRAY - 1) * np.exp(-0.5 * (off / CLOSE_M) ** 2)).sum())


def weigh(world: MapWorld, seen: Seen, pose: Matrix, way: Matrix, rivals_m: tuple[float, ...] = RIVALS_M) -> Evidence:
    """The evidence of a scan for a pose (4, 4); way: (3,) the direction in which it is least certain."""
    here = support(world, seen.standing, pose)
    held = np.zeros((6, 6))
    held[:3, :3] = HELD * np.outer(way, way)
    there = []
    for shift in (sign * metres for metres in rivals_m for sign in (-1, 1)):
        start = shifted(pose, shift * way)
        rival = world.fit(seen.all, start, SETTLE, Prior(start, held))
        there.append(support(world, seen.standing, rival.pose))
    usual = float(np.median(there))
    beside = [support(world, seen.standing, shifted(pose, sign * NEAREST * way)) for sign in (-1, 1)]
    possible = -np.log(STRAY) * len(seen.standing) - usual
    return Evidence(here - usual, here - max(there), possible, here - float(np.mean(beside)))


def shifted(pose: Matrix, metres: Matrix) -> Matrix:
    """A pose (4, 4), moved by (3,) metres of the map."""
    there = pose.copy()
    there[:3, 3] += metres
    return there


def weakest(covariance: Matrix) -> Matrix:
    """(3,) the horizontal direction in which a position is least certain."""
    level = covariance[:2, :2]
    way = np.linalg.eigh(level)[1][:, -1] if np.isfinite(level).all() else np.array([1.0, 0.0])
    return np.array([*way, 0.0])


def _some(points: Matrix, most: int) -> Matrix:
    return points[:: -(-len(points) // most) or 1]
