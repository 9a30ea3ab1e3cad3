"""Boxes of a simulated frame, each at the moment at which the sensor looks at it.

A turn takes a tenth of a second, in which a car moves by metres. So each box is taken at the time of the returns in its
direction. Where a turn begins, it sees an object twice, at its start and at its end. Such an object counts only if it
hardly moves in between, as seen from the sensor.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.evaluation.detection.boxes import Boxes, joined
from lidarcodec.evaluation.rigid import Matrix, invert
from lidarcodec.sources.drive import ROAD_USERS, SimulatedDrive

DIRECTIONS: Final = 360
MOMENTS: Final = 33
"""Times in a turn at which the pose of the sensor is asked for; between them it is interpolated."""
TORN_M: Final = 0.2
REACH_M: Final = 80.0


def boxes_of(drive: SimulatedDrive, cloud: npt.NDArray[np.void]) -> Boxes:
    """The boxes of road users within 80 m.

    cloud: of the whole frame, as of Frame.cloud. Frames are asked for in their order.
    """
    if not len(cloud):
        return joined(())
    first, last = _times_by_direction(cloud)
    moments = np.linspace(cloud["t_ns"].min(), cloud["t_ns"].max(), MOMENTS).astype(np.int64)
    into_sensor = invert(drive.poses(moments))
    middle_ns = int(moments[MOMENTS // 2])
    users = drive.road_users(middle_ns, REACH_M)
    world = np.stack([users[name] for name in "xyz"], axis=-1)
    speed = np.stack((users["vx"], users["vy"], np.zeros(len(users))), axis=-1)

    def seen(times_ns: npt.NDArray[np.float64]) -> tuple[Matrix, Matrix]:
        """Middles (N, 3) as seen at a time (N,) each, and T_sensor_world (N, 4, 4)."""
        at = np.clip(
            (times_ns - moments[0]) / max(float(moments[-1] - moments[0]), 1.0) * (MOMENTS - 1), 0, MOMENTS - 1
        )
        low = np.minimum(at.astype(np.intp), MOMENTS - 2)
        share = (at - low)[:, None, None]
        pose = into_sensor[low] * (1 - share) + into_sensor[low + 1] * share
        place = world + speed * ((times_ns - middle_ns) * 1e-9)[:, None]
        return np.einsum("nij,nj->ni", pose[:, :3, :3], place) + pose[:, :3, 3], pose

    middle, pose = seen(np.full(len(users), float(middle_ns)))
    for _ in range(2):
        toward = _direction(middle[:, 0], middle[:, 1])
        early, _ = seen(first[toward])
        late, _ = seen(last[toward])
        middle, pose = seen((first[toward] + last[toward]) / 2)
    whole = np.linalg.norm(late - early, axis=1) < TORN_M
    inward = np.stack([np.cos(users["yaw_rad"]), np.sin(users["yaw_rad"]), np.zeros(len(users))], axis=-1)
    along = np.einsum("nij,nj->ni", pose[:, :3, :3], inward)
    up = pose[:, :3, 2]
    axes = np.stack((along, np.cross(up, along), up), axis=1)
    size = np.stack([users[name] for name in ("length_m", "width_m", "height_m")], axis=-1)
    kinds = [ROAD_USERS[kind] for kind in users["kind"]]
    chosen = np.flatnonzero(whole)
    return Boxes(
        tuple(kinds[at] for at in chosen),
        tuple(users["id"][chosen].tolist()),
        middle[chosen],
        axes[chosen],
        size[chosen],
    )


def _direction(x: npt.NDArray[np.floating], y: npt.NDArray[np.floating]) -> npt.NDArray[np.intp]:
    turns = np.arctan2(y, x) / (2 * np.pi)
    found: npt.NDArray[np.intp] = np.floor(turns * DIRECTIONS).astype(np.intp) % DIRECTIONS
    return found


def _times_by_direction(cloud: npt.NDArray[np.void]) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """When the sensor looked into each direction for the first and for the last time in a turn, (DIRECTIONS,) ns."""
    toward = _direction(cloud["x"], cloud["y"])
    times = cloud["t_ns"]
    first = np.full(DIRECTIONS, np.iinfo(np.int64).max)
    last = np.full(DIRECTIONS, np.iinfo(np.int64).min)
    np.minimum.at(first, toward, times)
    np.maximum.at(last, toward, times)
    seen = np.flatnonzero(last >= first)
    nearest = seen[
        np.abs((np.arange(DIRECTIONS)[:, None] - seen + DIRECTIONS // 2) % DIRECTIONS - DIRECTIONS // 2).argmin(1)
    ]
    return first[nearest].astype(np.float64), last[nearest].astype(np.float64)
