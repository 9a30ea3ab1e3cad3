"""Poses: the pose of the sensor at any time, interpolated between the poses of a file.

    .npz  T_world_velo (F, 4, 4) with velo_mid (F,), seconds since the Unix epoch
    .txt  TUM: "time x y z qx qy qz qw" a line, seconds since the Unix epoch
    .txt  KITTI odometry: a 3 x 4 matrix a line, a line a scan; times.txt and calib.txt are read beside it

Times from the start of a drive (KITTI odometry) are `relative`, and so are times made for a file without any (one pose
for each turn of 103.4 ms); `starting` moves them to the start of the stream. Between two poses the position is linear
in time and the rotation is a slerp. Poses are extrapolated by at most one interval; beyond that none is known. Nor is
one in a hole over which the sensor moved: nobody knows by which way.

>>> ahead = np.eye(4)
>>> ahead[0, 3] = 2.0
>>> Poses(np.array([0, 100]), np.stack([np.eye(4), ahead])).at(75)[0, 3]
np.float64(1.5)
"""

from __future__ import annotations

import logging
import math
from array import array
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.budgets import FileTooLargeError, largest, read_file
from lidarcodec.errors import SourceError
from lidarcodec.sources.kitti.points import REVOLUTION_NS
from lidarcodec.untrusted.npz import read_npz

logger = logging.getLogger(__name__)

NPZ_POSES: Final = ("T_world_velo", "T_world_sensor")
NPZ_TIMES: Final = ("velo_mid", "stamps", "time")
MAX_COLUMNS: Final = 16
HOLE_NS: Final = 1_000_000_000
HOLE_STEPS: Final = 5
"""A hole is longer than a second, and than so many usual steps between two poses."""
STANDS_M: Final = 5.0
STANDS: Final = math.cos(math.radians(5.0) / 2)
"""A sensor that is no farther than this from where it was, turned by less than 5 degrees, stood, or crept straight on:
poses of a SLAM come only where it moved by a metre or a few. STANDS is the least product of the two quaternions."""

Matrix = npt.NDArray[np.float64]


class Poses:
    """T_world_sensor at any time.

    stamps_ns: (F,) int64, rising; matrices: (F, 4, 4) float64, rigid transforms
    Raises SourceError for other shapes, matrices that are not rigid, or times that do not increase.
    """

    _warned = False

    def __init__(self, stamps_ns: npt.NDArray[np.int64], matrices: Matrix, *, relative: bool = False) -> None:
        if matrices.ndim != 3 or matrices.shape[1:] != (4, 4) or len(matrices) != len(stamps_ns) or not len(stamps_ns):
            raise SourceError(f"poses must be (F, 4, 4) with F times, not {matrices.shape} with {stamps_ns.shape}")
        turns = matrices[:, :3, :3]
        if not np.isfinite(matrices).all() or np.abs(turns @ turns.transpose(0, 2, 1) - np.eye(3)).max() > 1e-3:
            raise SourceError("poses must be rigid transforms: a rotation matrix and a position, all finite")
        if np.any(np.linalg.det(turns) < 0):
            raise SourceError("poses must be rigid transforms, not mirrored ones")
        if np.any(np.diff(stamps_ns) <= 0):
            raise SourceError("the times of poses must increase")
        self.stamps_ns = stamps_ns.astype(np.int64)
        self.positions = np.ascontiguousarray(matrices[:, :3, 3], dtype=np.float64)
        self.quaternions = _quaternions(turns)
        self.relative = relative
        self._find_holes()

    def _find_holes(self) -> None:
        """Which steps from a pose to the next are holes, over which the sensor moved."""
        steps = np.diff(self.stamps_ns)
        self._usual_ns = float(np.median(steps)) if len(steps) else 0.0
        moved = np.linalg.norm(np.diff(self.positions, axis=0), axis=1) > STANDS_M
        moved |= np.abs((self.quaternions[1:] * self.quaternions[:-1]).sum(axis=1)) < STANDS
        self._holes = (steps > max(HOLE_NS, HOLE_STEPS * self._usual_ns)) & moved

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def at(self, stamp_ns: int) -> Matrix | None:
        """(4, 4) T_world_sensor at a host time; None where no pose is known. Cost: about 30 us."""
        stamps = self.stamps_ns
        if len(stamps) == 1:
            return _matrix(self.positions[0], self.quaternions[0]) if stamp_ns == stamps[0] else None
        after = min(max(int(np.searchsorted(stamps, stamp_ns)), 1), len(stamps) - 1)
        if self._holes[after - 1]:
            after = self._beside(after, stamp_ns)
        if self._holes[after - 1]:
            return None
        start, end = int(stamps[after - 1]), int(stamps[after])
        part = (stamp_ns - start) / (end - start)
        if not -1.0 <= part <= 2.0:
            return None
        position = self.positions[after - 1] + part * (self.positions[after] - self.positions[after - 1])
        return _matrix(position, _slerp(self.quaternions[after - 1], self.quaternions[after], part))

    def _beside(self, after: int, stamp_ns: int) -> int:
        """For a time in the step to pose `after`, a hole: the step before it or behind it, if that is near."""
        if after > 1 and stamp_ns - self.stamps_ns[after - 1] <= self._usual_ns:
            return after - 1
        near = self.stamps_ns[after] - stamp_ns <= self._usual_ns
        return after + 1 if near and after + 1 < len(self.stamps_ns) else after

    def tell_unknown(self, stamp_ns: int) -> None:
        """Warn once that no pose is known at a host time, so that frames are sent without a pose."""
        if not self._warned:
            self._warned = True
            stamps = self.stamps_ns
            if stamps[0] < stamp_ns < stamps[-1]:
                after = int(np.searchsorted(stamps, stamp_ns))
                why = "have a hole, over which the sensor moved, from {} to {}"
                ends = stamps[after - 1], stamps[after]
            else:
                why, ends = "cover only {} to {}", (stamps[0], stamps[-1])
            logger.warning(
                "frames from %s on are sent without a pose, because the poses %s",
                _time_text(stamp_ns), why.format(*(_time_text(int(end)) for end in ends)),
            )  # fmt: skip

    def seen_from(self, T_vehicle_sensor: Matrix) -> Poses:
        """These poses, which are of a vehicle, as those of a sensor on it. T_vehicle_sensor: (4, 4)"""
        return _OfSensor(self, T_vehicle_sensor)

    def starting(self, start_ns: int) -> Poses:
        """These poses; relative ones moved so that their time 0 is `start_ns`."""
        if not self.relative:
            return self
        moved = object.__new__(Poses)
        moved.stamps_ns, moved.relative = self.stamps_ns + start_ns, False
        moved.positions, moved.quaternions = self.positions, self.quaternions
        moved._find_holes()
        return moved


class _OfSensor(Poses):
    """Poses of a sensor, by those of its vehicle: between two of them, the vehicle moves evenly, not the sensor."""

    def __init__(self, vehicle: Poses, T_vehicle_sensor: Matrix) -> None:
        self.stamps_ns, self.positions, self.quaternions = vehicle.stamps_ns, vehicle.positions, vehicle.quaternions
        self.relative = vehicle.relative
        self._vehicle, self._T_vehicle_sensor = vehicle, T_vehicle_sensor

    def at(self, stamp_ns: int) -> Matrix | None:
        found = self._vehicle.at(stamp_ns)
        return None if found is None else np.asarray(found @ self._T_vehicle_sensor, np.float64)

    def starting(self, start_ns: int) -> Poses:
        return _OfSensor(self._vehicle.starting(start_ns), self._T_vehicle_sensor)


def _time_text(stamp_ns: int) -> str:
    return str(np.datetime64(stamp_ns, "ns").astype("datetime64[ms]")) + " UTC"


def read_poses(path: Path) -> Poses:
    """Poses of a file: .npz, TUM or KITTI odometry.

    Raises SourceError if it cannot be read or is none of them.
    """
    try:
        if path.suffix == ".npz":
            return _read_npz(path)
        table = _table(path)
        if table.shape[1] == 8:
            return _from_tum(table)
        if table.shape[1] == 12:
            return _from_kitti(path, table)
        raise SourceError(f"{path}: a line of poses must have 8 numbers (TUM) or 12 (KITTI), not {table.shape[1]}")
    except UnicodeDecodeError:
        raise SourceError(f"cannot read poses from {path}: it is not a text file") from None
    except OSError as error:
        raise SourceError(f"cannot read poses from {path}: {error.strerror or error}") from None
    except (ValueError, np.linalg.LinAlgError) as error:
        raise SourceError(f"cannot read poses from {path}: {error}") from None


def _read_npz(path: Path) -> Poses:
    file = read_npz(path, (*NPZ_POSES, *NPZ_TIMES), most_bytes=largest("npz") or 0)
    name = next((n for n in NPZ_POSES if n in file), None)
    if name is None:
        raise SourceError(f"{path} has no array T_world_velo (F, 4, 4)")
    matrices = np.asarray(file[name], np.float64)
    time = next((n for n in NPZ_TIMES if n in file), None)
    if time is None:
        # poses of these files are for the middle of a turn, when the sensor looks forward
        return _without_times(path, matrices, REVOLUTION_NS // 2)
    return Poses(_nanoseconds(np.asarray(file[time], np.float64)), matrices)


def _from_tum(table: Matrix) -> Poses:
    length = np.linalg.norm(table[:, 4:], axis=1, keepdims=True)
    if np.any(np.abs(length - 1.0) > 1e-2):
        raise SourceError("a quaternion in the poses does not have length 1")
    x, y, z, w = (table[:, 4:] / length).T
    matrices = np.zeros((len(table), 4, 4))
    matrices[:, :3, :3] = _rotations(np.stack([w, x, y, z], axis=1))
    matrices[:, :3, 3], matrices[:, 3, 3] = table[:, 1:4], 1.0
    return Poses(_nanoseconds(table[:, 0]), matrices)


def _from_kitti(path: Path, table: Matrix) -> Poses:
    """Poses of KITTI odometry, which are of the left camera. calib.txt has the transform from sensor to camera."""
    matrices = np.zeros((len(table), 4, 4))
    matrices[:, :3], matrices[:, 3, 3] = table.reshape(-1, 3, 4), 1.0
    calibration = path.with_name("calib.txt")
    if calibration.exists():
        T_camera_velo = _camera_from_velo(calibration)
        matrices = np.linalg.inv(T_camera_velo) @ matrices @ T_camera_velo
    else:
        logger.warning(
            "%s: there is no calib.txt beside it, so its poses are read as poses of the sensor, not of the camera", path
        )
    times = path.with_name("times.txt")
    if not times.exists():
        return _without_times(path, matrices, 0)
    stamps = _nanoseconds(_table(times)[:, 0])
    if len(stamps) < len(matrices):
        raise SourceError(f"{times} has {len(stamps)} times, but there are {len(matrices)} poses")
    return Poses(stamps[: len(matrices)], matrices, relative=True)


def _without_times(path: Path, matrices: Matrix, first_ns: int) -> Poses:
    logger.warning("%s has no times, so it is read as one pose for each turn of %.1f ms", path, REVOLUTION_NS / 1e6)
    stamps = np.arange(len(matrices), dtype=np.int64) * REVOLUTION_NS + first_ns
    return Poses(stamps, matrices, relative=True)


def _camera_from_velo(path: Path) -> Matrix:
    for line in _text(path).splitlines():
        name, _, numbers = line.partition(":")
        if name in ("Tr", "Tr_velo_to_cam", "Tr_velo_cam"):
            transform = np.eye(4)
            transform[:3] = np.array(numbers.split(), np.float64).reshape(3, 4)
            return transform
    raise SourceError(f"{path} has no line 'Tr:' with the transform from sensor to camera")


def _table(path: Path) -> Matrix:
    """(lines, values) float64 of a text file.

    Raises SourceError if its lines differ in length.
    """
    numbers, columns = array("d"), 0
    for line in _text(path).splitlines():
        if line.strip() and not line.startswith("#"):
            row = line.split(maxsplit=MAX_COLUMNS)
            columns = columns or len(row)
            if len(row) != columns or columns > MAX_COLUMNS:
                raise SourceError(f"{path} is not a table of poses: all lines must have the same number of values")
            numbers.extend(map(float, row))
    if not columns:
        raise SourceError(f"{path} is empty")
    return np.array(numbers, np.float64).reshape(-1, columns)


def _text(path: Path) -> str:
    try:
        return read_file(path, "poses").decode()
    except FileTooLargeError as error:
        raise SourceError(f"cannot read poses from {path}: {error}") from None


def _nanoseconds(seconds: Matrix) -> npt.NDArray[np.int64]:
    if seconds.ndim != 1 or not np.all(np.abs(seconds) < 4e9):  # also catches NaN
        raise SourceError("the times of poses must be seconds since the Unix epoch")
    whole = np.floor(seconds)
    return whole.astype(np.int64) * 1_000_000_000 + np.rint((seconds - whole) * 1e9).astype(np.int64)


def _rotations(quaternions: Matrix) -> Matrix:
    """(F, 3, 3) rotation matrices of (F, 4) unit quaternions w x y z."""
    w, x, y, z = quaternions.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def _quaternions(turns: Matrix) -> Matrix:
    """(F, 4) unit quaternions w x y z of (F, 3, 3) rotations: eigenvectors (Bar-Itzhack 2000), stable for any angle."""
    xx, xy, xz, yx, yy, yz, zx, zy, zz = turns.reshape(-1, 9).T
    symmetric = np.array(
        [
            [xx + yy + zz, zy - yz, xz - zx, yx - xy],
            [zy - yz, xx - yy - zz, yx + xy, zx + xz],
            [xz - zx, yx + xy, yy - xx - zz, zy + yz],
            [yx - xy, zx + xz, zy + yz, zz - xx - yy],
        ]
    )
    return np.ascontiguousarray(np.linalg.eigh(np.moveaxis(symmetric, 2, 0))[1][:, :, 3])


def _slerp(start: Matrix, end: Matrix, part: float) -> Matrix:
    cosine = float(start @ end)
    if cosine < 0.0:
        end, cosine = -end, -cosine
    angle = math.acos(min(cosine, 1.0))
    if angle < 1e-6:
        mixed = start + part * (end - start)
        return mixed / np.linalg.norm(mixed)
    return (math.sin((1.0 - part) * angle) * start + math.sin(part * angle) * end) / math.sin(angle)


def _matrix(position: Matrix, quaternion: Matrix) -> Matrix:
    matrix = np.eye(4)
    matrix[:3, :3] = _rotations(quaternion[None])[0]
    matrix[:3, 3] = position
    return matrix
