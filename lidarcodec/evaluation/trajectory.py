"""Where the sensor was in each frame, to a centimetre: registered, because GPS and inertia are not that good.

KITTI's positions slide sideways by 0.13-0.16 m in a second, so scans have to be registered where centimetres count.
`odometry` chains them (scan to map by small_gicp, or kiss-icp); `refine` aligns every scan with
one map of all, which takes out what the chain had gathered. Both deskew: a return is moved to where the sensor saw it
from at the scan's stamp, by the time at which its own column fired and the sensor's speed. No direction of rotation is
assumed, and none can be taken the wrong way round.

A pose is T_world_sensor at a scan's stamp, the middle of its columns; a velocity is (v, w) in m/s and rad/s along and
about the sensor's own axes there.

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
"""Returns taken for registration: the vehicle itself is nearer, and what is further weighs more than it is sure."""
MAP_EVERY: Final = 5
MAP_CELL_M: Final = 0.2
_FINE: Final = ((0.6, 20, 1e-3), (0.3, 20, 3e-4))
"""Correspondence distance, iterations, and the step at which it is enough, for each stage against the map."""
_PAIR: Final = ((0.8, 20, 1e-3), (0.4, 20, 3e-4))
_LEAST_POINTS: Final = 50
_BENT: Final = 9
"""Scans from whose beginning an odometer has found the speed."""

Tick = Callable[[], None]


class Scan(NamedTuple):
    """The returns of a frame, as the sensor saw them. points: (N, 3) float32, metres; after_s: (N,) float32, the time
    of each after `stamp_ns`, seconds, negative for those before."""

    stamp_ns: int
    points: npt.NDArray[np.float32]
    after_s: npt.NDArray[np.float32]


def scan_of(frame: Frame) -> Scan:
    """The valid returns of a frame; stamped between its first and last column with a return (its own, if none)."""
    cloud = frame.cloud()
    times = cloud["t_ns"]
    stamp = (int(times[0]) + int(times[-1])) // 2 if len(times) else frame.stamp_ns
    points = np.stack([cloud[axis] for axis in "xyz"], axis=1)
    return Scan(stamp, points, ((times - stamp) * 1e-9).astype(np.float32))


def deskewed(scan: Scan, velocity: Matrix) -> Matrix:
    """(N, 3) float64, the returns seen from where the sensor was at the scan's stamp; velocity: (6,), even over it."""
    after = scan.after_s.astype(np.float64)[:, None]
    points = scan.points.astype(np.float64)
    turn = velocity[3:] * after
    once = np.cross(turn, points)
    straight: Matrix = points + once + 0.5 * np.cross(turn, once) + velocity[:3] * after
    return straight


@dataclass(frozen=True)
class Trajectory:
    """stamps_ns: (F,) int64, rising; matrices: (F, 4, 4) T_world_sensor; velocities: (F, 6)."""

    stamps_ns: npt.NDArray[np.int64]
    matrices: Matrix
    velocities: Matrix

    @classmethod
    def from_matrices(cls, stamps_ns: Iterable[int], matrices: Matrix) -> Trajectory:
        """Velocities are differences between the poses before and after.

        Raises SourceError if the stamps do not rise or the poses are no rigid transforms.
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
        """What a file of poses, or the simulator, knows of these moments.

        Raises SourceError if it does not know one of them.
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
        """The same as poses at any time."""
        return Poses(self.stamps_ns, self.matrices)

    def save(self, path: Path) -> None:
        """Write an .npz that `--poses` of every command reads."""
        np.savez(path, T_world_velo=self.matrices, velo_mid=self.stamps_ns * 1e-9, stamps_ns=self.stamps_ns,
                 velocities=self.velocities)  # fmt: skip

    @classmethod
    def load(cls, path: Path) -> Trajectory:
        """What `save` wrote. Raises SourceError."""
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
        raise SourceError(f"the poses do not cover {missing / 1e9:.3f} s in which there are scans")
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
    """Means of points by cell over many scans, each scan once a cell, and in how many scans a cell was seen."""

    def __init__(self, cell_m: float) -> None:
        self._cell_m = cell_m
        self._sums, self._seen = np.empty((0, 3)), np.empty(0, np.int64)
        self._new: list[Matrix] = []

    def add(self, points: Matrix) -> None:
        """The points of a scan in the world, (N, 3), at most one in a cell."""
        self._new.append(points)
        if sum(map(len, self._new)) > 2 * len(self._seen) + 5_000_000:  # a long drive must not be kept whole
            self._gather()

    def means(self, least_seen: int = 1) -> Matrix:
        """(M, 3) float64, the mean of each cell that at least so many scans have seen."""
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
            raise SourceError("a map of scans is more than 100 km wide: the poses must be wrong")
        _, place = np.unique((cells[:, 0] << 42) | (cells[:, 1] << 21) | cells[:, 2], return_inverse=True)
        self._seen = np.bincount(place, seen).astype(np.int64)
        self._sums = np.stack([np.bincount(place, means[:, axis] * seen) for axis in range(3)], axis=1)


class PlaneMap:
    """Points with normals that scans are aligned with, point to plane. points: (N, 3), at least 50 for a result."""

    def __init__(self, points: Matrix, neighbours: int = 20) -> None:
        import small_gicp

        if len(points) < _LEAST_POINTS:
            raise SourceError(f"a map of {len(points)} points is too small to register scans with")
        self._cloud = small_gicp.PointCloud(np.ascontiguousarray(points, np.float64))
        self._tree = small_gicp.KdTree(self._cloud)
        small_gicp.estimate_normals(self._cloud, self._tree, neighbours, 1)

    def align(self, points: Matrix, start: Matrix, stages: Sequence[tuple[float, int, float]] = _FINE) -> Matrix:
        """(4, 4) T_map_sensor of points (M, 3) of the sensor that stood about at `start`; that, if they are too few."""
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


def map_of(
    scans: Sequence[Scan],
    trajectory: Trajectory,
    every: int = MAP_EVERY,
    cell_m: float = MAP_CELL_M,
    least_seen: int = 1,
) -> Matrix:
    """(M, 3) float64, voxel means in the world of every `every`-th scan, 3 to 80 m from the sensor.

    least_seen: scans, of these, that must have a return in a cell: with more than 1, few moving things are left.
    """
    seen = CellMeans(cell_m)
    for k in range(0, len(scans), every):
        seen.add(voxel_means(moved(trajectory.matrices[k], near(deskewed(scans[k], trajectory.velocities[k]))), cell_m))
    return seen.means(least_seen)


def refine(scans: Sequence[Scan], start: Trajectory, rounds: int = 1, tick: Tick = lambda: None) -> Trajectory:
    """Every scan aligned with one map of all of them, and the velocities from that; about 0.2 s a scan and round.

    Starts must be within about 0.3 m. From 18 scans on, the map is of what two scans saw, so few moving cars. A drive
    that comes back to a place by another way needs its loop closed before.

    Raises SourceError if scans and poses do not fit each other, or there is too little to register.
    """
    if len(scans) != len(start):
        raise SourceError(f"{len(scans)} scans cannot be refined with {len(start)} poses")
    found = start
    for _ in range(rounds):
        reference = PlaneMap(map_of(scans, found, least_seen=2 if len(scans) >= 2 * _BENT else 1))
        poses = []
        for k in range(len(scans)):
            seen = voxel_means(near(deskewed(scans[k], found.velocities[k])), 0.35)
            poses.append(reference.align(seen, found.matrices[k]))
            tick()
        found = Trajectory.from_matrices(found.stamps_ns, np.stack(poses))
    return found


def odometer_of(method: str) -> type[KissOdometer] | type[GicpOdometer]:
    """What chains scans by that name. Raises UnknownNameError; making one raises MissingExtraError."""
    if method not in ODOMETRIES:
        raise UnknownNameError("odometry", method, ODOMETRIES)
    return KissOdometer if method == "kiss-icp" else GicpOdometer


def odometry(scans: Iterable[Scan], method: str = "auto", tick: Tick = lambda: None) -> Trajectory:
    """The scans chained one to the next, from the identity; 0.1-0.5 s a scan. `refine` it before centimetres count.

    A drive that begins at speed deceives a chain, which knows no speed yet: the first scans are bent, and 0.3 m are
    lost on them. So the first nine are chained again, backwards, with the speed found by then.

    method: kiss-icp (extra `annotate`), small_gicp, or auto, which is small_gicp
    Raises UnknownNameError, MissingExtraError; SourceError for no scans.
    """
    kind = odometer_of(method)
    chain = _Chain(kind())
    first: list[Scan] = []
    for scan in scans:
        chain.add(scan)
        if len(first) < _BENT:
            first.append(scan)
        tick()
    if not first:
        raise SourceError("there is no frame for odometry")
    poses = chain.poses
    if len(first) > 2:
        last = len(first) - 1
        back = _Chain(kind(), Trajectory.from_matrices(chain.stamps, np.stack(poses)).velocities[last])
        for scan in reversed(first):
            back.add(scan)
        poses[:last] = [poses[last] @ pose for pose in back.poses[:0:-1]]
    return Trajectory.from_matrices(chain.stamps, invert(poses[0]) @ np.stack(poses))


class _Chain:
    """Scans, in time or against it, each begun from where the motion between the last two leads."""

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
    """(K, 3) float64, metres forward, left and up: how far the way from a scan to the one `gap` later is from what
    these two say by themselves, by what stands 2 m above the road, where no cars are. Its rms is the noise of a
    trajectory that was registered, and how far one from GPS slides. Pairs with too little up there are left out.
    """
    found = []
    for k in range(0, len(scans) - gap, step):
        here, there = (
            seen[seen[:, 2] > 0.3]
            for seen in (near(deskewed(scans[i], trajectory.velocities[i]), 4.0, 60.0) for i in (k, k + gap))
        )
        if min(len(here), len(there)) < 3000:
            continue
        said = invert(trajectory.matrices[k]) @ trajectory.matrices[k + gap]
        seen = PlaneMap(voxel_means(here, 0.15)).align(voxel_means(there, 0.2), said, _PAIR)
        found.append(said[:3, 3] - seen[:3, 3])
    return np.array(found).reshape(-1, 3)
