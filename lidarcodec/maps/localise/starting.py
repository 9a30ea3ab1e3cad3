"""Start: the places that a start may mean, followed over several scans until one of them is clearly the best.

On a road the first scan fits at every place along it, and the second one at every speed. So several places are kept,
and from each of them several speeds are tried. What stands beside the road then tells, scan after scan.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from lidarcodec.evaluation.rigid import Matrix, exp_so3, invert, log_so3
from lidarcodec.maps.localise.evidence import NONE, Evidence, seen_from, shifted, support, weakest, weigh
from lidarcodec.maps.localise.window import Window
from lidarcodec.maps.world import INFLATED, NEAR, Fit, MapWorld, Prior, inverse

SPREAD_M: Final = (0.0, 1.0, -1.0, 2.0, -2.0, 3.0, -3.0, 4.0, -4.0, 5.0, -5.0, 6.0, -6.0)
"""Where places are tried along the direction that is least certain."""
SPEEDS_M_S: Final = (-8.0, 40.0)
"""Slowest and fastest of the speeds that are tried between the first scans."""
STEP_M: Final = 0.8
"""How far apart these speeds lead from one scan to the next."""
LEAST_SPEEDS, MOST_SPEEDS = 4, 25
MOST: Final = 8
"""Places that are kept."""
APART_M: Final = 0.75
"""Places nearer than this are one."""
OTHER_M: Final = 1.0
"""A place farther away than this is another place."""
LOOSE: Final = ((0.5, 0.05), (0.3, 0.02))
"""How far a scan may be from where it is expected, in metres and radians, while speeds are tried and later."""
CLEAR: Final = INFLATED * float(np.log(100.0))
"""Evidence with which a place is clearly better than others: a hundred to one, where ten returns side by side count as
one."""
SHARE: Final = 0.2
"""Part of what could speak for a place that must. Measured: 0.23 and more at right places of whole scans, less than 0.1
at places of another road, and up to 0.23 by chance, for a few scans, on a road whose posts were all moved."""
SURE: Final = 0.4
"""With less, a place is followed for SOME_SCANS: what agrees by chance seldom does so for long."""
BRANCHING: Final = 2
"""Scans from which all speeds are tried: the first one's place may be a metre off, its speed ten metres a second."""
BARE: Final = 0.05
"""With less, nothing speaks for a place."""
LEAST_SCANS, SOME_SCANS, MOST_SCANS = 3, 6, 10
"""Scans after which a place may be clear, after which that part must speak for it, and after which it must be clear."""


class Guess(NamedTuple):
    """A place that a start may mean. velocity: None before the second scan; score: log likelihood over all scans."""

    pose: Matrix
    velocity: Matrix | None
    score: float
    fit: Fit
    evidence: Evidence = NONE


class Start:
    """Guesses, the best one first. scans: how many it has seen; interval: seconds between the last two"""

    def __init__(self, stamp_ns: int, world: MapWorld, cloud: Matrix, fit: Fit) -> None:
        """fit: of the first cloud (N, 3)"""
        self.stamp_ns, self.scans, self.interval, self._world = stamp_ns, 1, 0.0, world
        seen, way = seen_from(cloud, fit.pose), weakest(fit.covariance)
        tried = []
        for metres in SPREAD_M:
            place = shifted(fit.pose, metres * way)
            found = world.fit(seen.all, place, NEAR, _loosely(place, LOOSE[0]))
            tried.append(Guess(found.pose, None, support(world, seen.standing, found.pose), found))
        self.guesses = _different(tried)

    @property
    def best(self) -> Guess:
        """The best guess."""
        return self.guesses[0]

    @property
    def clear(self) -> bool:
        """Whether the best place is clearly better than all others, and enough speaks for it."""
        best = self.best
        others = [
            one.score for one in self.guesses if np.linalg.norm(one.pose[:3, 3] - best.pose[:3, 3]) > OTHER_M
        ]  # fmt: skip
        margin = best.score - max(others, default=-np.inf)  # those that are far worse were left out
        share = best.evidence.share
        enough = self.scans >= (LEAST_SCANS if share >= SURE else SOME_SCANS)
        return enough and min(margin, best.evidence.lead) >= CLEAR and share >= SHARE

    @property
    def hopeless(self) -> bool:
        """Whether too little speaks for any place, or for one against others after many scans."""
        share = self.best.evidence.share
        least = SHARE if self.scans >= SOME_SCANS else BARE if self.scans >= LEAST_SCANS else -np.inf
        return self.scans >= MOST_SCANS or share < least

    def take(self, stamp_ns: int, window: Window, cloud_of: Callable[[Matrix], Matrix]) -> None:
        """Follow all guesses to one more scan. cloud_of: the scan, straightened by a velocity (6,)."""
        took = (stamp_ns - self.stamp_ns) * 1e-9
        self._world = window.around(self.best.pose[:3, 3]) or self._world
        followed = []
        for velocity, guesses in self._expected(took):
            clouds = {}
            for guess in guesses:
                expected = guess.pose @ motion(velocity, took)
                key = velocity.tobytes()
                if key not in clouds:
                    clouds[key] = seen_from(cloud_of(velocity), expected)
                seen = clouds[key]
                prior = _loosely(expected, LOOSE[self.scans > BRANCHING])
                found = self._world.fit(seen.all, expected, NEAR, prior)
                moved_by = velocity_of(guess.pose, found.pose, took)
                score = guess.score + support(self._world, seen.standing, found.pose)
                followed.append(Guess(found.pose, moved_by, score, found, guess.evidence))
        self.stamp_ns, self.interval = stamp_ns, took
        self.scans += 1
        best, *others = _different(followed)
        assert best.velocity is not None
        cloud = cloud_of(best.velocity)
        new = weigh(self._world, seen_from(cloud, best.pose), best.pose, weakest(best.fit.covariance))
        self.guesses = [best._replace(evidence=best.evidence.and_then(new)), *others]

    def _expected(self, took: float) -> list[tuple[Matrix, list[Guess]]]:
        """Velocities, and the guesses that are followed with each."""
        if self.scans > BRANCHING:
            return [(one.velocity, [one]) for one in self.guesses if one.velocity is not None]
        return [(np.array([speed, 0.0, 0.0, 0.0, 0.0, 0.0]), self.guesses) for speed in _speeds(took)]


def _speeds(took: float) -> Matrix:
    slowest, fastest = SPEEDS_M_S
    count = round((fastest - slowest) * took / STEP_M) + 1
    return np.linspace(slowest, fastest, min(max(count, LEAST_SPEEDS), MOST_SPEEDS))


def motion(velocity: Matrix, took: float) -> Matrix:
    """(4, 4) the step of a velocity (6,) in a time in seconds."""
    step = np.eye(4)
    step[:3, :3], step[:3, 3] = exp_so3(velocity[3:] * took), velocity[:3] * took
    return step


def velocity_of(before: Matrix, after: Matrix, took: float) -> Matrix:
    """(6,) m/s and rad/s along the sensor's axes, between two poses."""
    step = invert(before) @ after
    found: Matrix = np.hstack([step[:3, 3], log_so3(step[None, :3, :3])[0]]) / took
    return found


def _loosely(pose: Matrix, by: tuple[float, float]) -> Prior:
    metres, radians = by
    return Prior(pose, inverse(np.diag([metres**2] * 3 + [radians**2] * 3)))


def _different(guesses: list[Guess]) -> list[Guess]:
    """The best guesses, without those that are at the place of a better one, or are far worse."""
    kept: list[Guess] = []
    for guess in sorted(guesses, key=lambda one: -one.score):
        if guess.score < kept[0].score - 2 * CLEAR if kept else False:
            break
        if all(np.linalg.norm(guess.pose[:3, 3] - other.pose[:3, 3]) > APART_M for other in kept):
            kept.append(guess)
    return kept[:MOST]
