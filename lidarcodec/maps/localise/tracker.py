"""Tracker: the pose of a sensor in a map, scan by scan, and whether it can be trusted.

    searching   no pose is known yet
    tracking    the last scans lie in the map
    lost        a pose was known, and several scans in a row do not lie in the map, or do not say where they are

A scan is registered from where the last motion leads. It is good if enough of its returns lie in the map, and if the
pose follows from them: its standard deviation is small in every direction. A pose found by a search or given from
outside counts once three scans in a row are good, and what stands above the ground lies in the map, too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, Literal, NamedTuple

import numpy as np

from lidarcodec.evaluation.localisation.icp import COARSE
from lidarcodec.evaluation.rigid import Matrix, exp_so3, invert, log_so3, moved
from lidarcodec.evaluation.trajectory import Scan, deskewed, near, voxel_means
from lidarcodec.maps.localise.standing import above_ground, is_here
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
CONFIRMING: Final = 3
"""Good scans in a row from which on a new pose counts."""
MISSES: Final = 5
"""Scans in a row that are not good, after which the position is lost."""
GAP_S: Final = 5.0
"""After a longer time without a scan the last motion leads nowhere: the position is lost."""
ACCELERATION: Final = (5.0, 2.0)
"""m/s^2 and rad/s^2 that a vehicle may have against the model of constant velocity."""
FASTEST_M_S: Final = 80.0
SPEEDS_M_S: Final = (0.0, 8.0, 16.0, 24.0, 32.0, 40.0, -8.0)
"""Speeds that are tried between the first two scans."""
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
    """The last pose, its covariance, and the motion (v, w) in m/s and rad/s along the sensor's axes."""

    stamp_ns: int
    pose: Matrix
    covariance: Matrix
    velocity: Matrix
    usual: float
    """Share of a scan's returns that lie in the map, over the last scans."""
    good: int = 1
    missed: int = 0

    @property
    def least(self) -> float:
        """Share that a good scan has."""
        return max(KEPT, OF_USUAL * self.usual)

    def after(self, stamp_ns: int) -> tuple[Matrix, Matrix]:
        """Pose and covariance that are expected at a later time."""
        took = (stamp_ns - self.stamp_ns) * 1e-9
        step = np.eye(4)
        step[:3, :3], step[:3, 3] = exp_so3(self.velocity[3:] * took), self.velocity[:3] * took
        metres, radians = (0.5 * most * took**2 for most in ACCELERATION)
        # the velocity is the difference of two poses: 2 p1 - p0 has five times the variance of one
        grown = 5 * self.covariance + np.diag([metres**2] * 3 + [radians**2] * 3)
        return self.pose @ step, grown


class Tracker:
    """Tracks one sensor in a map. lost_times: how often the position was lost"""

    def __init__(self, window: Window) -> None:
        self._window = window
        self._state: State = "searching"
        self._known: _Known | None = None
        self._proposed: list[Matrix] = []
        self.lost_times = 0

    @property
    def state(self) -> State:
        """State after the last scan."""
        return self._state

    @property
    def unknown(self) -> bool:
        """Whether no pose is being tracked or confirmed, so that a search would help."""
        return self._known is None

    def propose(self, pose: Matrix) -> None:
        """Try an approximate pose (4, 4), up to 5 m and 20 degrees off, with the next scan, unless one is tracked."""
        if self._known is None:  # the place before stays, where the position was lost
            turned = [pose @ turned_by(degrees) for degrees in TURNS_DEG]
            self._proposed = [*turned, *self._proposed[: len(TURNS_DEG)]]

    def found(self, stamp_ns: int, fit: Fit) -> None:
        """Begin with a pose that a search found for an earlier scan."""
        self._begin(stamp_ns, fit)

    def track(self, scan: Scan) -> Estimate:
        """The estimate after one more scan; scans come in the order of their stamps, others are not used.

        Raises SourceError if the map has too many points around the pose.
        """
        known = self._known
        if known is not None and abs(scan.stamp_ns - known.stamp_ns) > GAP_S * 1e9:
            self._lose(known)
        elif known is not None and scan.stamp_ns <= known.stamp_ns:
            return Estimate(scan.stamp_ns, self._state, None, None, 0.0, 0.0)
        fit = self._try_proposed(scan) if self._known is None else self._go_on(self._known, scan)
        known = self._known
        if known is None or self._state != "tracking":
            return Estimate(scan.stamp_ns, self._state, None, None, fit.share, fit.partners)
        return Estimate(scan.stamp_ns, "tracking", known.pose, known.covariance, fit.share, fit.partners)

    def cloud_of(self, scan: Scan) -> Matrix:
        """(N, 3) means of cells of a scan, straightened by the motion as far as it is known."""
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
        if is_good(best, FOUND):
            self._begin(scan.stamp_ns, best)
        return best

    def _begin(self, stamp_ns: int, fit: Fit) -> None:
        self._known = _Known(stamp_ns, fit.pose, fit.covariance, np.zeros(6), lying(fit))

    def _go_on(self, known: _Known, scan: Scan) -> Fit:
        """Register a scan from where the last motion leads. After the first one the motion is not known yet."""
        expected, covariance = known.after(scan.stamp_ns)
        first = known.good == 1
        took = (scan.stamp_ns - known.stamp_ns) * 1e-9
        fit, cloud, world = NOTHING, NO_POINTS, self._window.around(expected[:3, 3])
        if world is not None:
            cloud = self.cloud_of(scan)
            if first:
                fit = _moving(world, cloud, expected, took)
            else:
                fit = world.fit(cloud, expected, NEAR, Prior(expected, inverse(covariance)))
            if not first and not is_good(fit, known.least):
                fit = max(fit, world.fit(cloud, expected, WIDE), key=lying)
        step = invert(known.pose) @ fit.pose
        # not before: a start that is metres off may need two scans to come to its place
        here = known.good + 1 != CONFIRMING or (world is not None and is_here(world, cloud, fit))
        if here and is_good(fit, known.least) and np.linalg.norm(step[:3, 3]) < FASTEST_M_S * max(took, 0.05):
            velocity = np.hstack([step[:3, 3], log_so3(step[None, :3, :3])[0]]) / took
            usual = known.usual + FORGETTING * (lying(fit) - known.usual)
            self._known = _Known(scan.stamp_ns, fit.pose, fit.covariance, velocity, usual, known.good + 1)
            if self._known.good >= CONFIRMING:
                self._state = "tracking"
        elif known.missed + 1 >= MISSES or known.good < CONFIRMING or sigma_m(covariance) > MOST_SIGMA_M:
            self._lose(known)
        else:
            self._known = replace(
                known, stamp_ns=scan.stamp_ns, pose=expected, covariance=covariance, missed=known.missed + 1
            )
        return fit

    def _lose(self, known: _Known) -> None:
        self._known = None
        if known.good >= CONFIRMING:
            self._state = "lost"
            self.lost_times += 1
            self.propose(known.pose)


def _moving(world: MapWorld, cloud: Matrix, pose: Matrix, took: float) -> Fit:
    """A cloud a moment after the pose of the scan before, of a vehicle of unknown speed: the best of several speeds.

    On an open road a scan lies nearly as well where the vehicle was before. What stands beside the road tells.
    """
    best, most = NOTHING, -1.0
    for speed in SPEEDS_M_S:
        ahead = np.eye(4)
        ahead[0, 3] = speed * took
        fit = world.fit(cloud, pose @ ahead, WIDE)
        score = lying(fit) + world.upright(cloud[above_ground(moved(fit.pose, cloud))], fit.pose)
        if score > most:
            best, most = fit, score
    return best


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


def is_good(fit: Fit, least: float) -> bool:
    """Whether enough of the scan lies in the map, and the pose follows from it."""
    return lying(fit) >= least and sigma_m(fit.covariance) <= MOST_SIGMA_M and fit.facing >= FACING
