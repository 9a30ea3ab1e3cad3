"""Sensor poses to a centimetre, by registration of scans, because GPS and inertial sensors are not precise enough.

KITTI's positions drift sideways by 0.13-0.16 m in a second, so precise poses need registered scans. `odometry` chains
scans (scan to map by small_gicp, or kiss-icp). `refine` aligns every scan with one map of all scans, which removes the
accumulated drift. Both deskew: each return is transformed to the sensor's pose at the scan's stamp, from the firing
time of its column and the sensor's velocity. This works for any direction of rotation.

A pose is T_world_sensor at a scan's stamp, the middle of its columns. A velocity is (v, w) in m/s and rad/s along and
about the sensor's axes at that time.

>>> from lidarcodec.api import read_frames
>>> scans = [scan_of(frame) for frame in read_frames("sim:street?frames=2")]
>>> still = Trajectory.from_matrices([s.stamp_ns for s in scans], np.stack([np.eye(4)] * 2))
>>> deskewed(scans[0], still.velocities[0]).shape == scans[0].points.shape
True
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec.budgets import largest
from lidarcodec.errors import SourceError, UnknownNameError
from lidarcodec.evaluation.odometers import FARTHEST_M as ODOMETRY_M
from lidarcodec.evaluation.odometers import GicpOdometer, KissOdometer, Odometer
from lidarcodec.evaluation.rigid import Matrix, exp_so3, invert, log_so3, moved
from lidarcodec.frame import Frame
from lidarcodec.sources.drive import SimulatedPoses
from lidarcodec.sources.poses import Poses
from lidarcodec.untrusted.npz import ArraysRefusedError, read_npz

ODOMETRIES: Final = ("auto", "kiss-icp", "small_gicp")
NEAREST_M, FARTHEST_M = 3.0, 80.0
"""Limits of returns for registration. The vehicle itself is nearer, and the errors of farther returns weigh too
much."""
MAP_EVERY: Final = 5
MAP_CELL_M: Final = 0.2
_FINE: Final = ((0.6, 20, 1e-3), (0.3, 20, 3e-4))
"""Correspondence distance, iterations, and step at which to stop, for each stage of registration in the map."""
_PAIR: Final = ((0.8, 20, 1e-3), (0.4, 20, 3e-4))
_LEAST_POINTS: Final = 50
_SETTLING_SCANS: Final = 9
"""Number of scans after which an odometer has found the velocity."""

Tick = Callable[[], None]


class Scan(NamedTuple):
    """The returns of a frame, without deskewing. points: (N, 3) float32, metres; after_s: (N,) float32, time of each
    return after `stamp_ns` in seconds, negative if it was earlier"""

    stamp_ns: int
    points: npt.NDArray[np.float32]
    after_s: npt.NDArray[np.float32]


def scan_of(frame: Frame) -> Scan:
    """The valid returns of a frame. The stamp is the middle between its first and last column with a return; without
    returns it is the frame's stamp."""
    cloud = frame.cloud()
    times = cloud["t_ns"]
    stamp = (int(times[0]) + int(times[-1])) // 2 if len(times) else frame.stamp_ns
    points = np.stack([cloud[axis] for axis in "xyz"], axis=1)
    return Scan(stamp, points, ((times - stamp) * 1e-9).astype(np.float32))


def deskewed(scan: Scan, velocity: Matrix) -> Matrix:
    """(N, 3) float64, the returns relative to the sensor's pose at the scan's stamp. velocity: (6,), constant during
    the scan"""
    after = scan.after_s.astype(np.float64)[:, None]
    points = scan.points.astype(np.float64)
    turn = velocity[3:] * after
    once = np.cross(turn, points)
    straight: Matrix = points + once + 0.5 * np.cross(turn, once) + velocity[:3] * after
    return straight


@dataclass(frozen=True)
class Trajectory:
    """stamps_ns: (F,) int64, increasing; matrices: (F, 4, 4) T_world_sensor; velocities: (F, 6)"""

    stamps_ns: npt.NDArray[np.int64]
    matrices: Matrix
    velocities: Matrix

    @classmethod
    def from_matrices(cls, stamps_ns: Iterable[int], matrices: Matrix) -> Trajectory:
        """A trajectory from poses. Velocities are differences between the previous and the next pose.

        Raises SourceError if the stamps do not increase or the poses are not rigid transforms.
        """
        poses = Poses(np.array(list(stamps_ns), np.int64), np.asarray(matrices, np.float64))  # checks
        stamps, count = poses.stamps_ns, len(poses.stamps_ns)
        before, after = np.maximum(np.arange(count) - 1, 0), np.minimum(np.arange(count) + 1, count - 1)
        took = np.maximum((stamps[after] - stamps[before]) * 1e-9, 1e-9)[:, None]
        inverse = invert(matrices)
        ahead, behind = inverse @ matrices[after], inverse @ matrices[before]
        turned = log_so3(np.swapaxes(behind[:, :3, :3], 1, 2) @ ahead[:, :3, :3])
        velocities = np.hstack([ahead[:, :3, 3] - behind[:, :3, 3], turned]) / took
        return cls(stamps, np.asarray(matrices, np.float64), velocities)

    @classmethod
    def from_poses(cls, poses: Poses, stamps_ns: Sequence[int]) -> Trajectory:
        """A trajectory from poses of a file or the simulator, at these times.

        Raises SourceError if the poses do not cover all of them.
        """
        stamps = np.array(stamps_ns, np.int64)
        offsets = (-20_000_000, 0, 20_000_000)
        found = [_looked_up(poses, stamps + offset) for offset in offsets]
        inverse = invert(found[1])
        ahead, behind = inverse @ found[2], inverse @ found[0]
        turned = log_so3(np.swapaxes(behind[:, :3, :3], 1, 2) @ ahead[:, :3, :3])
        velocities = np.hstack([ahead[:, :3, 3] - behind[:, :3, 3], turned]) / ((offsets[2] - offsets[0]) * 1e-9)
        return cls(stamps, found[1], velocities)

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def poses(self) -> Poses:
        """The trajectory as poses that can be interpolated."""
        return Poses(self.stamps_ns, self.matrices)

    def save(self, path: Path) -> None:
        """Write an .npz that `--poses` of every command reads."""
        np.savez(path, T_world_velo=self.matrices, velo_mid=self.stamps_ns * 1e-9, stamps_ns=self.stamps_ns,
                 velocities=self.velocities)  # fmt: skip

    @classmethod
    def load(cls, path: Path) -> Trajectory:
        """Read a file of `save`. Raises SourceError."""
        try:
            file = read_npz(path, most_bytes=largest("npz") or 0)
            found = cls(file["stamps_ns"], file["T_world_velo"], file["velocities"])
        except (OSError, ArraysRefusedError, KeyError) as error:
            raise SourceError(f"cannot read the trajectory {path}: {error}") from None
        count = len(found.stamps_ns)
        if found.matrices.shape != (count, 4, 4) or found.velocities.shape != (count, 6):
            raise SourceError(f"{path} is not a trajectory: its arrays do not match")
        return found


def _looked_up(poses: Poses, stamps: npt.NDArray[np.int64]) -> Matrix:
    if isinstance(poses, SimulatedPoses):
        return poses(np.maximum(stamps, poses.stamps_ns[0]))
    found = [poses.at(int(stamp)) for stamp in stamps]
    missing = next((int(stamp) for stamp, pose in zip(stamps, found, strict=True) if pose is None), None)
    if missing is not None:
        raise SourceError(f"the poses do not cover {missing / 1e9:.3f} s of the drive: give poses for all of it")
    return np.stack([pose for pose in found if pose is not None])


def near(points: Matrix, least_m: float = NEAREST_M, most_m: float = FARTHEST_M) -> Matrix:
    """The points between two distances from the sensor."""
    squared = np.einsum("ij,ij->i", points, points)
    chosen: Matrix = points[(squared > least_m**2) & (squared < most_m**2)]
    return chosen


def voxel_means(points: Matrix, cell_m: float) -> Matrix:
    """(M, 3) float64, the mean of the points of each occupied cell. Cost: 15 ms for 120,000 points."""
    import small_gicp

    if not len(points):
        return np.empty((0, 3))
    means: Matrix = np.asarray(small_gicp.voxelgrid_sampling(np.ascontiguousarray(points, np.float64), cell_m).points())
    return np.ascontiguousarray(means[:, :3])


class CellMeans:
    """Means of points by cell over many scans, with one point of each scan, and the number of scans that saw a cell."""

    def __init__(self, cell_m: float) -> None:
        self._cell_m = cell_m
        self._sums, self._seen = np.empty((0, 3)), np.empty(0, np.int64)
        self._new: list[Matrix] = []

    def add(self, points: Matrix) -> None:
        """Add the points of a scan in the world, (N, 3), at most one in each cell."""
        self._new.append(points)
        if sum(map(len, self._new)) > 2 * len(self._seen) + 5_000_000:  # bounds memory for a long drive
            self._gather()

    def means(self, least_seen: int = 1) -> Matrix:
        """(M, 3) float64, the mean of each cell that at least `least_seen` scans saw."""
        self._gather()
        chosen = self._seen >= least_seen
        means: Matrix = self._sums[chosen] / self._seen[chosen, None]
        return means

    def _gather(self) -> None:
        before = self._sums / np.maximum(self._seen, 1)[:, None]
        means = np.concatenate([before, *self._new])
        seen = np.concatenate([self._seen, *(np.ones(len(new), np.int64) for new in self._new)])
        self._new = []
        cells = np.floor(means / self._cell_m).astype(np.int64) + (1 << 20)
        if len(cells) and not 0 <= cells.min() <= cells.max() < 1 << 21:
            raise SourceError("the scans are spread over more than 100 km: check the poses")
        _, place = np.unique((cells[:, 0] << 42) | (cells[:, 1] << 21) | cells[:, 2], return_inverse=True)
        self._seen = np.bincount(place, seen).astype(np.int64)
        self._sums = np.stack([np.bincount(place, means[:, axis] * seen) for axis in range(3)], axis=1)


class PlaneMap:
    """A map of points with normals for point-to-plane registration. points: (N, 3), at least 50"""

    def __init__(self, points: Matrix, neighbours: int = 20) -> None:
        import small_gicp

        if len(points) < _LEAST_POINTS:
            raise SourceError(f"the map has {len(points)} points, which is too few to register scans")
        self._cloud = small_gicp.PointCloud(np.ascontiguousarray(points, np.float64))
        self._tree = small_gicp.KdTree(self._cloud)
        small_gicp.estimate_normals(self._cloud, self._tree, neighbours, 1)

    def align(self, points: Matrix, start: Matrix, stages: Sequence[tuple[float, int, float]] = _FINE) -> Matrix:
        """(4, 4) T_map_sensor for points (M, 3) in the sensor's frame. `start` is the approximate pose, and the
        result if there are too few points."""
        import small_gicp

        if len(points) < _LEAST_POINTS:
            return start
        found, source = start, small_gicp.PointCloud(np.ascontiguousarray(points, np.float64))
        for reach_m, iterations, step_m in stages:
            result = small_gicp.align(
                self._cloud, source, self._tree, found, registration_type="PLANE_ICP", num_threads=1,
                max_correspondence_distance=reach_m, max_iterations=iterations,
                rotation_epsilon=step_m / 20, translation_epsilon=step_m,
            )  # fmt: skip
            found = np.asarray(result.T_target_source, np.float64)
        return found


def map_of(scans: Sequence[Scan], trajectory: Trajectory, every: int = MAP_EVERY, least_seen: int = 1) -> Matrix:
    """(M, 3) float64, voxel means in the world of every `every`-th scan, 3 to 80 m from the sensor.

    least_seen: least number of scans with a return in a cell; with more than 1, most moving objects are removed
    """
    seen = CellMeans(MAP_CELL_M)
    for k in range(0, len(scans), every):
        points = near(deskewed(scans[k], trajectory.velocities[k]))
        seen.add(voxel_means(moved(trajectory.matrices[k], points), MAP_CELL_M))
    return seen.means(least_seen)


def refine(scans: Sequence[Scan], start: Trajectory, rounds: int = 1, tick: Tick = lambda: None) -> Trajectory:
    """Align every scan with one map of all scans, and compute the velocities; about 0.2 s for each scan and round.

    Start poses must be correct to about 0.3 m. From 18 scans on, the map has only cells that two scans saw, which
    removes most moving cars. If a drive returns to a place on another way, close the loop before.

    Raises SourceError if the numbers of scans and poses differ, or there are too few points to register.
    """
    if len(scans) != len(start):
        raise SourceError(f"there are {len(scans)} scans, but {len(start)} poses to refine")
    found = start
    for _ in range(rounds):
        reference = PlaneMap(map_of(scans, found, least_seen=2 if len(scans) >= 2 * _SETTLING_SCANS else 1))
        poses = []
        for k in range(len(scans)):
            seen = voxel_means(near(deskewed(scans[k], found.velocities[k])), 0.35)
            poses.append(reference.align(seen, found.matrices[k]))
            tick()
        found = Trajectory.from_matrices(found.stamps_ns, np.stack(poses))
    return found


def odometer_of(method: str) -> type[KissOdometer] | type[GicpOdometer]:
    """The class of an odometry method. Raises UnknownNameError; making an object raises MissingExtraError."""
    if method not in ODOMETRIES:
        raise UnknownNameError("odometry", method, ODOMETRIES)
    return KissOdometer if method == "kiss-icp" else GicpOdometer


def odometry(scans: Iterable[Scan], method: str = "auto", tick: Tick = lambda: None) -> Trajectory:
    """Odometry: registers each scan relative to the earlier ones, starting at the identity; 0.1-0.5 s a scan. For
    centimetres, `refine` the result.

    If a drive begins at speed, the velocity is not known yet: the first scans are not deskewed correctly, which causes
    an error of about 0.3 m. So the first nine scans are registered again, backwards, with the velocity found by then.

    method: kiss-icp (extra `annotate`), small_gicp, or auto (small_gicp)
    Raises UnknownNameError, MissingExtraError; SourceError if there are no scans.
    """
    kind = odometer_of(method)
    chain = _Chain(kind())
    first: list[Scan] = []
    for scan in scans:
        chain.add(scan)
        if len(first) < _SETTLING_SCANS:
            first.append(scan)
        tick()
    if not first:
        raise SourceError("the source has no frame for odometry")
    poses = chain.poses
    if len(first) > 2:
        last = len(first) - 1
        back = _Chain(kind(), Trajectory.from_matrices(chain.stamps, np.stack(poses)).velocities[last])
        for scan in reversed(first):
            back.add(scan)
        poses[:last] = [poses[last] @ pose for pose in back.poses[:0:-1]]
    return Trajectory.from_matrices(chain.stamps, invert(poses[0]) @ np.stack(poses))


class _Chain:
    """Registers scans, forwards or backwards in time. The start of each is predicted from the last motion."""

    def __init__(self, odometer: Odometer, velocity: Matrix | None = None) -> None:
        self._odometer = odometer
        self._velocity = np.zeros(6) if velocity is None else velocity
        self.stamps: list[int] = []
        self.poses: list[Matrix] = []

    def add(self, scan: Scan) -> None:
        """Find the pose of the next scan, and the velocity since the last."""
        guess, took = np.eye(4), 0.0
        if self.poses:
            took = (scan.stamp_ns - self.stamps[-1]) * 1e-9
            guess[:3, :3], guess[:3, 3] = exp_so3(self._velocity[3:] * took), self._velocity[:3] * took
            guess = self.poses[-1] @ guess
        seen = near(deskewed(scan, self._velocity), most_m=ODOMETRY_M)
        pose = self._odometer.next(seen, guess)
        if took:
            step = invert(self.poses[-1]) @ pose
            self._velocity = np.hstack([step[:3, 3], log_so3(step[None, :3, :3])[0]]) / took
        self.stamps.append(scan.stamp_ns)
        self.poses.append(pose)


def disagreement(scans: Sequence[Scan], trajectory: Trajectory, gap: int = 8, step: int = 8) -> Matrix:
    """(K, 3) float64, metres forward, left and up: differences between the trajectory's motion from a scan to the one
    `gap` later, and the motion from registering these two scans directly. Only points at least 2 m above the road are
    used, because no cars are there. The rms is the noise of a registered trajectory, or the drift of GPS positions.
    Pairs with too few such points are skipped.
    """
    found = []
    for k in range(0, len(scans) - gap, step):
        here, there = (
            seen[seen[:, 2] > 0.3]
            for seen in (near(deskewed(scans[i], trajectory.velocities[i]), 4.0, 60.0) for i in (k, k + gap))
        )
        if min(len(here), len(there)) < 3000:
            continue
        moved_by = invert(trajectory.matrices[k]) @ trajectory.matrices[k + gap]
        registered = PlaneMap(voxel_means(here, 0.15)).align(voxel_means(there, 0.2), moved_by, _PAIR)
        found.append(moved_by[:3, 3] - registered[:3, 3])
    return np.array(found).reshape(-1, 3)
