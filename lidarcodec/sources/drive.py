"""SimulatedDrive: what simulated drives of all sensors have in common, and their exact poses."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec import _native
from lidarcodec.errors import SourceError, UnknownNameError
from lidarcodec.sensor_model import SensorModel
from lidarcodec.sources.base import PacketSource
from lidarcodec.sources.poses import Poses
from lidarcodec.units import FRAME_PACKETS

SCENES: Final = ("city", "road", "street", "bend", "motorway", "garage", "room")
START_NS: Final = 1_767_225_600_000_000_000
"""2026-01-01T00:00:00Z: default host and GPS time of the first packet."""
LABELS: Final = ("none", "ground", "building", "vegetation", "vehicle", "person", "pole", "other")
"""Name of each label in `truth`."""
ROAD_USERS: Final = ("none", "car", "van", "truck", "bus", "motorbike", "cyclist", "pedestrian")
"""Name of each kind in `road_users`."""
ROAD_USER_DTYPE: Final = np.dtype(
    [("kind", "u1"), ("id", "u4"), ("x", "f8"), ("y", "f8"), ("z", "f8"), ("yaw_rad", "f8"), ("length_m", "f8"),
     ("width_m", "f8"), ("height_m", "f8"), ("vx", "f8"), ("vy", "f8")]
)  # fmt: skip
"""Of `road_users`. x, y, z: middle of the box in the world, in metres; vx, vy: metres a second in the world."""
MAX_SEED: Final = 2**53 - 1
MAX_FRAMES: Final = 10**9
MAX_SKIP: Final = 10**6
FARTHEST_M: Final = 1e8
MOST_REACH_M: Final = 200.0
LONGEST_NS: Final = 30 * 86_400 * 10**9
"""Poses are found up to 30 days into a drive."""


class SimulatedPoses(Poses):
    """T_world_sensor of a simulated drive at any time, computed by simulating the drive again. World coordinates are
    those of the scene, in metres, z up; the first pose is not the identity.
    """

    def __init__(self, options: tuple[str, int, float, float], start_ns: int) -> None:
        self._finder = _native.SimulatorPoses(*options)
        self._options, self._start_ns = options, start_ns
        self.stamps_ns = np.array([start_ns], np.int64)
        self.relative = False

    def __call__(self, stamps_ns: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """(N, 4, 4) float64 at N host times, in any order: the poses used to simulate the packets.

        Times after the last call are fast (0.1 ms for each simulated second); earlier ones restart the drive.
        Raises SourceError for times before the start or 30 days after it.
        """
        times = np.asarray(stamps_ns, np.int64).reshape(-1) - self._start_ns
        if times.size and not 0 <= times.min() <= times.max() <= LONGEST_NS:
            raise SourceError(f"sim:{self._options[0]}: only the first 30 days of a simulated drive have poses")
        order = np.argsort(times, kind="stable")
        found: npt.NDArray[np.float64] = np.empty((len(times), 4, 4))
        found[order] = self._finder.at(np.ascontiguousarray(times[order]))
        return found

    def at(self, stamp_ns: int) -> npt.NDArray[np.float64] | None:
        """(4, 4) T_world_sensor at a host time; None before the start."""
        if not 0 <= stamp_ns - self._start_ns <= LONGEST_NS:
            return None
        found: npt.NDArray[np.float64] = self([stamp_ns])[0]
        return found

    def starting(self, start_ns: int) -> Poses:
        """These poses: their times are absolute."""
        return self


class SimulatedDrive(PacketSource):
    """A drive through a simulated scene: what it has in common for all sensors. Arguments as of SimulatorSource.

    frame_packets: packets of a turn; of an HDL-64E 348, in which `skip` is counted: its turns have 358 to 360
    """

    poses: SimulatedPoses
    start_ns: int
    frame_packets: int = FRAME_PACKETS

    def __init__(
        self,
        sensor: SensorModel,
        scene: str,
        seed: int,
        frames: int | None,
        *,
        speed: float | None,
        traffic: float,
        skip: int,
        start_ns: int,
    ) -> None:
        if scene not in SCENES:
            raise UnknownNameError("simulated scene", scene, SCENES)
        if not 0 <= seed <= MAX_SEED:
            raise SourceError(f"sim:{scene}: seed must be a whole number from 0 to {MAX_SEED}, not {seed}")
        if frames is not None and not 1 <= frames <= MAX_FRAMES:
            raise SourceError(f"sim:{scene}: frames must be a whole number from 1 to {MAX_FRAMES}, not {frames}")
        if speed is not None and not 0.5 <= speed <= 40.0:
            raise SourceError(f"sim:{scene}: speed must be 0.5 to 40 m/s, not {speed}")
        if not 0.0 <= traffic <= 3.0:
            raise SourceError(f"sim:{scene}: traffic must be a number from 0 to 3, not {traffic}")
        if not 0 <= skip <= MAX_SKIP:
            raise SourceError(f"sim:{scene}: skip must be a whole number from 0 to {MAX_SKIP}, not {skip}")
        if not 0 <= start_ns < 2**61:
            raise SourceError(f"sim:{scene}: start_ns must be a time since 1970 in ns, not {start_ns}")
        super().__init__(sensor)
        self.label = f"simulated {scene}, seed {seed}"
        self.scene, self.seed, self.frames = scene, seed, frames
        self._finder: _native.SimulatorPoses | None = None
        self._options = (scene, seed, 0.0 if speed is None else float(speed), float(traffic))
        self._begin(start_ns)

    def _begin(self, drive_ns: int) -> None:
        """Set the time at which the drive starts."""
        self.drive_ns = drive_ns
        self.poses = SimulatedPoses(self._options, drive_ns)

    def ground_height(self, places: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """(N,) float64, height of the ground in the world at N places (N, 2): road, pavement or yard, without grass."""
        at = np.ascontiguousarray(np.asarray(places, np.float64).reshape(-1, 2))
        if not np.all(np.abs(at) < FARTHEST_M):
            raise SourceError(f"sim:{self.scene}: the simulated world ends {FARTHEST_M:g} m from its centre")
        height: npt.NDArray[np.float64] = _native.Simulator(*self._options, self.drive_ns).ground_height(at)
        return height

    def road_users(self, stamp_ns: int, reach_m: float = 80.0) -> npt.NDArray[np.void]:
        """(N,) ROAD_USER_DTYPE, vehicles and people within `reach_m` of the sensor at a host time, parked ones too.

        Boxes hold all parts: mirrors of cars, feet of walkers. A kind is an index into ROAD_USERS; an id stays the same
        during the drive. Later times than that of the last call are fast, earlier ones drive again from the start.
        Raises SourceError for a time before the start or 30 days after it, or a reach beyond 200 m.
        """
        since_ns = int(stamp_ns) - self.drive_ns
        if not (0 <= since_ns <= LONGEST_NS and 0 < reach_m <= MOST_REACH_M):
            raise SourceError(f"sim:{self.scene}: only the first 30 days, up to 200 m away, have labelled road users")
        if self._finder is None:
            self._finder = _native.SimulatorPoses(*self._options)
        kinds, ids, numbers = self._finder.road_users(since_ns, float(reach_m))
        x, y, z, c, s, vx, vy = numbers[:, :7].T
        low, high = numbers[:, 7:10], numbers[:, 10:]
        middle, size = (low + high) / 2, high - low
        users = np.empty(len(kinds), ROAD_USER_DTYPE)
        users["kind"], users["id"], users["vx"], users["vy"] = kinds, ids, vx, vy
        users["x"] = x + c * middle[:, 0] - s * middle[:, 1]
        users["y"] = y + s * middle[:, 0] + c * middle[:, 1]
        users["z"] = z + middle[:, 2]
        users["yaw_rad"] = np.arctan2(s, c)
        for axis, name in enumerate(("length_m", "width_m", "height_m")):
            users[name] = size[:, axis]
        return users
