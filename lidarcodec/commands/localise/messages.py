"""What `localise` sends on the key `pose`, reads on the key `odometry`, and writes into a file of poses."""

from __future__ import annotations

import json
import math
from typing import Any, Final

import numpy as np

from lidarcodec.errors import SourceError
from lidarcodec.evaluation.rigid import Matrix
from lidarcodec.interop.poses import quaternion_of
from lidarcodec.maps.localise.tracker import Estimate
from lidarcodec.sources.poses import Poses
from lidarcodec.untrusted.json import JsonRefusedError, read_object

MOST_BYTES: Final = 4096
FARTHEST_M: Final = 1e8
TUM: Final = "# time x y z qx qy qz qw\n"


def pose_json(estimate: Estimate, name: str, frame: str) -> bytes:
    """One estimate as JSON, as docs/live.md says. name, frame: of the map"""
    fields: dict[str, Any] = {
        "stamp_ns": estimate.stamp_ns,
        "state": estimate.state,
        "map": name,
        "frame": frame,
        "T_world_sensor": None,
        "covariance": None,
        "sigma_m": None,
        "sigma_deg": None,
        "share": round(estimate.share, 4),
        "partners": round(estimate.partners, 4),
    }
    if estimate.pose is not None and estimate.covariance is not None:
        sigma = np.sqrt(np.diag(estimate.covariance))
        fields |= {
            "T_world_sensor": [round(value, 9) for value in estimate.pose[:3].ravel().tolist()],
            "covariance": [float(f"{value:.6g}") for value in estimate.covariance.ravel().tolist()],
            "sigma_m": [round(value, 5) for value in sigma[:3].tolist()],
            "sigma_deg": [round(value, 5) for value in np.degrees(sigma[3:]).tolist()],
        }
    return json.dumps(fields).encode()


def read_odometry(data: bytes) -> tuple[int, Matrix] | None:
    """Stamp in ns and T_world_sensor (4, 4) of a vehicle's odometry; None if it is not one: an object with `stamp_ns`
    and `T_world_sensor`, 12 or 16 numbers, row by row."""
    try:
        fields = read_object(data, MOST_BYTES)
        stamp, numbers = fields["stamp_ns"], np.asarray(fields["T_world_sensor"], np.float64).ravel()
        if not isinstance(stamp, int) or abs(stamp) >= 1 << 63 or len(numbers) not in (12, 16):
            return None
        pose = np.eye(4)
        pose[:3] = numbers[:12].reshape(3, 4)
        Poses(np.zeros(1, np.int64), pose[None])  # checks that it is rigid
    except (JsonRefusedError, KeyError, TypeError, ValueError, SourceError):
        return None
    return (stamp, pose) if np.abs(pose[:3, 3]).max() < FARTHEST_M else None


def tum_line(stamp_ns: int, pose: Matrix) -> str:
    """A line of TUM's form."""
    seconds, rest = divmod(stamp_ns, 1_000_000_000)
    values = " ".join(f"{value:.9g}" if abs(value) < 1e5 else f"{value:.4f}" for value in pose[:3, 3])
    turn = " ".join(f"{value:.9f}" for value in quaternion_of(pose))
    return f"{seconds}.{rest:09d} {values} {turn}\n"


def place_of(pose: Matrix) -> str:
    """A pose in words: x, y, z in metres and yaw in degrees."""
    x, y, z = pose[:3, 3]
    return f"x {x:.2f}, y {y:.2f}, z {z:.2f}, yaw {math.degrees(math.atan2(pose[1, 0], pose[0, 0])):.1f}"
