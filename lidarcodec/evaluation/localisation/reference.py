"""The reference for estimates: the sensor's pose in the middle of every frame, and its velocity.

given     poses of the source (exact for a simulated drive), or of a file
refined   odometry from the scans, then registration of every scan in a map of every fifth scan

Satellite positions are not precise enough: those of KITTI drift sideways by 0.13 to 0.16 m within 0.8 s, and so would
a map made with them. So given poses are used only if they are exact, or if an option requests them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np

from lidarcodec.errors import SettingsError
from lidarcodec.evaluation.localisation.drive import Drive
from lidarcodec.evaluation.rigid import Matrix, exp_so3, invert, log_so3
from lidarcodec.evaluation.trajectory import (
    MAP_EVERY,
    PlaneMap,
    Trajectory,
    disagreement,
    map_of,
    odometry,
    refine,
    voxel_means,
)

ReferenceName = Literal["auto", "given", "refined"]
REFERENCES: Final[tuple[ReferenceName, ...]] = ("auto", "given", "refined")
HALF_CELL_M: Final = 0.35
ROUNDS: Final = 2
Tick = Callable[[], None]


@dataclass(frozen=True)
class Noise:
    """Uncertainty of a refined reference.

    metres, degrees: standard deviation of one pose, from halves of scans. slide_m: (forward, left, up), rms error of
    the motion over 0.8 s, measured by registering both scans directly; empty if there are too few high objects
    """

    metres: float
    degrees: float
    slide_m: tuple[float, ...]


@dataclass(frozen=True)
class Reference:
    """kind: `exact`, `given` or `refined`; noise: uncertainty of a refined reference"""

    trajectory: Trajectory
    kind: str
    noise: Noise | None = None

    @property
    def poses(self) -> Matrix:
        """(F, 4, 4) T_world_sensor."""
        return self.trajectory.matrices

    @property
    def velocities(self) -> Matrix:
        """(F, 6) m/s and rad/s in the sensor's own axes."""
        return self.trajectory.velocities

    def at(self, frame: int, seconds: float) -> Matrix:
        """(4, 4) the pose `seconds` after the stamp of a frame, at its velocity."""
        step = self.velocities[frame] * seconds
        pose: Matrix = self.poses[frame] @ pose_of(step[3:], step[:3])
        return pose

    def about(self) -> dict[str, Any]:
        """Kind and uncertainty as plain values."""
        if self.noise is None:
            return {"kind": self.kind, "noise_m": None, "noise_deg": None, "slide_m": None}
        slide = list(self.noise.slide_m) or None
        return {"kind": self.kind, "noise_m": self.noise.metres, "noise_deg": self.noise.degrees, "slide_m": slide}


def pose_of(vector: Matrix, position: Matrix) -> Matrix:
    """(4, 4) pose from a rotation vector in radians and a position."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = exp_so3(vector), position
    return pose


def find_reference(drive: Drive, name: ReferenceName = "auto", tick: Tick = lambda: None) -> Reference:
    """The reference for a drive. `auto` uses exact poses if there are any, and otherwise refines, about 1 s a frame.

    Raises SettingsError for `given` without poses, SourceError if they do not cover the drive.
    """
    if name == "given" and drive.poses is None:
        raise SettingsError(f"{drive.name} has no poses: give --poses FILE, or --reference refined", "reference")
    if drive.poses is not None and (name == "given" or (name == "auto" and drive.exact)):
        found = Trajectory.from_poses(drive.poses, drive.stamps_ns.tolist())
        return Reference(found, "exact" if drive.exact else "given")
    scans = [drive.scan(at) for at in range(len(drive.frames))]
    found = refine(scans, odometry(scans, tick=tick), ROUNDS, tick)
    apart = disagreement(scans, found)
    slide = tuple(float(value) for value in np.sqrt(np.mean(apart**2, axis=0))) if len(apart) else ()
    metres, degrees = _of_halves(drive, found)
    return Reference(found, "refined", Noise(metres, degrees, slide))


def _of_halves(drive: Drive, found: Trajectory) -> tuple[float, float]:
    """Standard deviation of one pose in metres and degrees. The even and the odd columns of a scan are registered
    separately. They share the map but no return. The uncertainty of a whole scan is half of their difference."""
    scans = [drive.scan(at) for at in range(len(drive.frames))]
    world = PlaneMap(map_of(scans, found))
    apart = []
    for at in range(1, len(found), MAP_EVERY):  # these scans are not in the map
        frame = drive.frames[at]
        odd = np.zeros(frame.range.shape, np.bool_)
        odd[:, ::2] = True
        ways = [
            world.align(voxel_means(drive.cloud(at, found.velocities[at], frame.with_(keep=keep)), HALF_CELL_M),
                        found.matrices[at])
            for keep in (odd, ~odd)
        ]  # fmt: skip
        apart.append(invert(ways[0]) @ ways[1])
    off = np.array(apart)
    metres = np.sqrt(np.mean(np.sum(off[:, :3, 3] ** 2, axis=1))) / 2
    degrees = np.degrees(np.sqrt(np.mean(np.sum(log_so3(off[:, :3, :3]) ** 2, axis=1)))) / 2
    return float(metres), float(degrees)
