"""Tracker: the pose of a sensor in a map, scan by scan, and whether it can be trusted.

    searching   no pose is known yet
    tracking    the last scans lie in the map
    lost        a pose was known, and several scans in a row do not lie in the map, or do not say where they are

A scan is registered from where the last motion leads. It is good if enough of its returns lie in the map, and if the
pose follows from them: its standard deviation is small in every direction. What stands above the ground must also
speak for this place against places metres away. A pose found by a search or given from outside counts once one of the
places that it may mean is clearly the best.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, Literal, NamedTuple

import numpy as np

from lidarcodec.evaluation.localisation.icp import COARSE
from lidarcodec.evaluation.rigid import Matrix, exp_so3
from lidarcodec.evaluation.trajectory import Scan, deskewed, near, voxel_means
from lidarcodec.maps.localise.evidence import NONE, RIVALS_M, Evidence, seen_from, shifted, support, weakest, weigh
from lidarcodec.maps.localise.standing import is_here
from lidarcodec.maps.localise.starting import CLEAR, SHARE, SPREAD_M, Start, motion, velocity_of
from lidarcodec.maps.localise.window import Window
from lidarcodec.maps.world import NEAR, Fit, MapWorld, Prior, inverse

State = Literal["searching", "tracking", "lost"]
CELL_M: Final = 0.5
MOST_RETURNS: Final = 30_000
"""Of a larger scan every n-th return is used."""
FOUND: Final = 0.3
"""Least share of a scan's returns that lie in the map at a pose that was not known before."""
KEPT: Final = 0.15
"""The same at a pose that follows from the last one."""
OF_USUAL: Final = 0.6
"""It is also at least this part of what was usual so far, because dense maps have more than thin ones."""
FORGETTING: Final = 0.05
"""Weight of the last scan in what is usual."""
MOST_SIGMA_M: Final = 0.5
"""Largest standard deviation of the position, in the worst direction."""
FACING: Final = 8
"""Fewest returns from which the position follows in the worst direction, as along an open road. A few planes that face
it, or many that nearly lie in it, agree with wrong places as well, and the standard deviation does not tell."""
MISSES: Final = 5
"""Scans in a row that are not good, after which the position is lost."""
GAP_S: Final = 5.0
"""After a longer time without a scan the last motion leads nowhere: the position is lost."""
ACCELERATION: Final = (5.0, 2.0)
"""m/s^2 and rad/s^2 that a vehicle may have against the model of constant velocity."""
FASTEST_M_S: Final = 80.0
REMEMBERED: Final = 0.8
"""Weight of the evidence of scans before."""
STILL_GAIN: Final = CLEAR / 2
STILL_SHARE: Final = SHARE / 2
"""Evidence that a sensor that is tracked needs."""
AGAINST: Final = 0.4
"""Less than this part of the evidence that is due speaks against the place of a scan."""
TURNS_DEG: Final = (0.0, -12.0, 12.0)
"""Turns of a proposed pose that are tried."""
WIDE: Final = (*COARSE[:3], *NEAR)


class Estimate(NamedTuple):
    """What one scan says.

    stamp_ns: host time of the pose; state: see above
    pose: (4, 4) T_map_sensor, and its covariance (6, 6) of position in m and rotation vector in rad along the map's
          axes; None unless tracking
    share: of the returns that have a partner in the map, those that lie on it; partners: of all returns, those that
           have a partner
    """

    stamp_ns: int
    state: State
    pose: Matrix | None
    covariance: Matrix | None
    share: float
    partners: float


@dataclass
class _Known:
    """The last good pose, its covariance, and the motion (v, w) in m/s and rad/s along the sensor's axes."""

    stamp_ns: int
    pose: Matrix
    covariance: Matrix
    velocity: Matrix
    usual: float
    """Share of a scan's returns that lie in the map, over the last scans."""
    evidence: Evidence
    """Of the last good scans."""
    interval: float
    """Seconds between the last two scans that were good."""
    number: int = 0
    missed: int = 0

    @property
    def least(self) -> float:
        """Share that a good scan has."""
        return max(KEPT, OF_USUAL * self.usual)

    def after(self, stamp_ns: int) -> tuple[Matrix, Matrix]:
        """Pose and covariance that are expected at a later time."""
        took = (stamp_ns - self.stamp_ns) * 1e-9
        metres, radians = (0.5 * most * took**2 for most in ACCELERATION)
        # the velocity is the difference of two poses: p1 + n (p1 - p0) has (n + 1)^2 + n^2 times the variance of one
        steps = took / self.interval
        growth = (steps + 1) ** 2 + steps**2
        grown = growth * self.covariance + np.diag([metres**2] * 3 + [radians**2] * 3)
        return self.pose @ motion(self.velocity, took), grown

    def contradicted(self, new: Evidence) -> bool:
        """Whether much should speak for the place of a scan, by the scans before, and little does."""
        due = self.evidence.share * new.possible
        return due > CLEAR and (new.gain < AGAINST * due or new.lead < 0)


class Tracker:
    """Tracks one sensor in a map. lost_times: how often the position was lost"""

    def __init__(self, window: Window) -> None:
        self._window = window
        self._state: State = "searching"
        self._known: _Known | None = None
        self._start: Start | None = None
        self._last_ns = 0
        self._proposed: list[Matrix] = []
        self.lost_times = 0

    @property
    def state(self) -> State:
        """State after the last scan."""
        return self._state

    @property
    def unknown(self) -> bool:
        """Whether no pose is being tracked or confirmed, so that a search would help."""
        return self._known is None and self._start is None

    def propose(self, pose: Matrix) -> None:
        """Try an approximate pose (4, 4), up to 5 m and 20 degrees off, with the next scan, unless one is tracked."""
        if self.unknown:  # the place before stays, where the position was lost
            turned = [pose @ turned_by(degrees) for degrees in TURNS_DEG]
            self._proposed = [*turned, *self._proposed[: len(TURNS_DEG)]]

    def found(self, scan: Scan, fit: Fit) -> None:
        """Begin with a pose that a search found for an earlier scan."""
        self._last_ns = scan.stamp_ns
        self._begin(scan.stamp_ns, self.cloud_of(scan), fit)

    def track(self, scan: Scan) -> Estimate:
        """The estimate after one more scan; scans come in the order of their stamps, others are not used.

        Raises SourceError if the map has too many points around the pose.
        """
        last_ns, self._last_ns = self._last_ns, scan.stamp_ns
        if not self.unknown and abs(scan.stamp_ns - last_ns) > GAP_S * 1e9:
            self._lose()
        elif not self.unknown and scan.stamp_ns <= last_ns:
            self._last_ns = last_ns
            return Estimate(scan.stamp_ns, self._state, None, None, 0.0, 0.0)
        if self._known is not None:
            fit = self._go_on(self._known, scan)
        elif self._start is not None:
            fit = self._confirm(self._start, scan)
        else:
            fit = self._try_proposed(scan)
        known = self._known
        if known is None or self._state != "tracking":
            return Estimate(scan.stamp_ns, self._state, None, None, fit.share, fit.partners)
        pose, covariance = known.after(scan.stamp_ns) if known.missed else (known.pose, known.covariance)
        return Estimate(scan.stamp_ns, "tracking", pose, covariance, fit.share, fit.partners)

    def cloud_of(self, scan: Scan, velocity: Matrix | None = None) -> Matrix:
        """(N, 3) means of cells of a scan, straightened by a velocity (6,), or by the motion as far as it is known."""
        if velocity is None:
            velocity = np.zeros(6) if self._known is None else self._known.velocity
        every = -(-len(scan.points) // MOST_RETURNS) or 1
        few = Scan(scan.stamp_ns, scan.points[::every], scan.after_s[::every])
        return voxel_means(near(deskewed(few, velocity)), CELL_M)

    def _try_proposed(self, scan: Scan) -> Fit:
        best, proposed = NOTHING, self._proposed
        self._proposed = []
        cloud = self.cloud_of(scan) if proposed else NO_POINTS
        for pose in proposed:
            world = self._window.around(pose[:3, 3])
            if world is not None:
                best = max(best, world.fit(cloud, pose, WIDE), key=lying)
        if lying(best) >= FOUND:
            self._begin(scan.stamp_ns, cloud, best)
        return best

    def _begin(self, stamp_ns: int, cloud: Matrix, fit: Fit) -> None:
        world = self._window.around(fit.pose[:3, 3])
        if world is not None:
            self._start = Start(stamp_ns, world, cloud, fit)

    def _confirm(self, start: Start, scan: Scan) -> Fit:
        """Follow the places that a start may mean, until one is clearly the best, or none will be."""
        start.take(scan.stamp_ns, self._window, lambda velocity: self.cloud_of(scan, velocity))
        best = start.best
        world = self._window.around(best.pose[:3, 3])
        cloud = self.cloud_of(scan, best.velocity)
        if start.clear and world is not None and best.velocity is not None:
            fit = world.fit(cloud, best.pose, NEAR, Prior(best.pose, inverse(best.fit.covariance)))
            if holds(fit, FOUND) and is_here(world, cloud, fit):
                self._start, self._state = None, "tracking"
                covariance, usual = at_least(fit.covariance, best.evidence), lying(fit)
                self._known = _Known(
                    scan.stamp_ns, fit.pose, covariance, best.velocity, usual, best.evidence, start.interval
                )
                return fit
        if start.hopeless:
            self._lose()
        return best.fit

    def _go_on(self, known: _Known, scan: Scan) -> Fit:
        """Register a scan from where the last motion leads."""
        expected, covariance = known.after(scan.stamp_ns)
        took = (scan.stamp_ns - known.stamp_ns) * 1e-9
        fit, new, evidence, world = NOTHING, NONE, known.evidence, self._window.around(expected[:3, 3])
        if world is not None:
            cloud = self.cloud_of(scan)
            fit = world.fit(cloud, expected, NEAR, Prior(expected, inverse(covariance)))
            if not holds(fit, known.least):
                fit = max(fit, world.fit(cloud, expected, WIDE), key=lying)
            fit, new = self._weighed(known, world, cloud, fit)
            evidence = known.evidence.and_then(new, REMEMBERED)
        velocity = velocity_of(known.pose, fit.pose, took)
        good = holds(fit, known.least) and not known.contradicted(new) and speaks(evidence)
        if good and np.linalg.norm(velocity[:3]) < FASTEST_M_S:
            usual = known.usual + FORGETTING * (lying(fit) - known.usual)
            covariance = at_least(fit.covariance, evidence)
            number = known.number + 1
            self._known = _Known(scan.stamp_ns, fit.pose, covariance, velocity, usual, evidence, took, number)
        elif known.missed + 1 >= MISSES or sigma_m(covariance) > MOST_SIGMA_M:
            self._lose()
        else:
            # its evidence is not forgotten: a scan that is found again must be as clear as those before
            self._known = replace(known, missed=known.missed + 1, number=known.number + 1)
        return fit

    def _weighed(self, known: _Known, world: MapWorld, cloud: Matrix, fit: Fit) -> tuple[Fit, Evidence]:
        """The fit and its evidence, or those of a place beside it, if what stands speaks for that."""
        way, seen = weakest(fit.covariance), seen_from(cloud, fit.pose)
        rivals = (RIVALS_M[known.number % len(RIVALS_M)],)
        new = weigh(world, seen, fit.pose, way, rivals)
        if not known.contradicted(new):
            return fit, new
        tried = [world.fit(seen.all, shifted(fit.pose, metres * way), NEAR) for metres in SPREAD_M]
        best = max(tried, key=lambda one: support(world, seen.standing, one.pose))
        other = weigh(world, seen, best.pose, way, rivals)
        return (fit, new) if known.contradicted(other) else (world.fit(cloud, best.pose, NEAR), other)

    def _lose(self) -> None:
        known, self._known, self._start = self._known, None, None
        if known is not None:
            self._state = "lost"
            self.lost_times += 1
            self.propose(known.pose)


def at_least(covariance: Matrix, evidence: Evidence) -> Matrix:
    """The covariance, and in its worst direction no less than the likelihood says."""
    way = weakest(covariance)
    more = evidence.variance - float(way @ covariance[:3, :3] @ way)
    if more <= 0:
        return covariance
    grown = covariance.copy()
    grown[:3, :3] += more * np.outer(way, way)
    return grown


def speaks(evidence: Evidence) -> bool:
    """Whether what stands still speaks for the place of a sensor that is tracked."""
    return evidence.lead > 0 and evidence.gain > STILL_GAIN and evidence.share > STILL_SHARE


NO_POINTS: Final = np.empty((0, 3))
NOTHING: Final = Fit(np.eye(4), np.full((6, 6), np.inf), 0.0, 0.0, 0)


def turned_by(degrees: float) -> Matrix:
    """(4, 4) a turn to the left."""
    turn = np.eye(4)
    turn[:3, :3] = exp_so3(np.array([0.0, 0.0, np.radians(degrees)]))
    return turn


def lying(fit: Fit) -> float:
    """Share of a scan's returns that lie in the map."""
    return fit.share * fit.partners


def sigma_m(covariance: Matrix) -> float:
    """Standard deviation of a position in its worst direction."""
    if not np.isfinite(covariance).all():
        return float("inf")
    return float(np.sqrt(np.linalg.eigvalsh(covariance[:3, :3])[-1]))


def holds(fit: Fit, least: float) -> bool:
    """Whether enough of the scan lies in the map, and the pose follows from it."""
    return lying(fit) >= least and sigma_m(fit.covariance) <= MOST_SIGMA_M


def is_good(fit: Fit, least: float) -> bool:
    """The same of a single scan, of which several returns must face the direction that is least certain."""
    return holds(fit, least) and fit.facing >= FACING
