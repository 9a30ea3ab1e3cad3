"""Mounting: where a sensor sits on its vehicle, and its MOUNT section (docs/wire-format-sections.md).

The vehicle's frame is x forward, y left, z up (REP 103). Its origin is any fixed point of the vehicle, the same for all
of its sensors.

>>> roof = Mounting.parse("1.5,0,1.8,0,0,90")
>>> roof.T_vehicle_sensor.round(3)[:2].tolist()
[[0.0, -1.0, 0.0, 1.5], [1.0, 0.0, 0.0, 0.0]]
>>> Mounting.of_matrix(roof.T_vehicle_sensor) == roof
True
>>> Mounting.parse("1.5,0")
Traceback (most recent call last):
lidarcodec.errors.SettingsError: a mounting is X,Y,Z,ROLL,PITCH,YAW in metres and degrees, not '1.5,0'
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import SectionError, SettingsError

Matrix = npt.NDArray[np.float64]
NAMES: Final = ("x_m", "y_m", "z_m", "roll_deg", "pitch_deg", "yaw_deg")
MOST_M: Final = 100.0
"""Farthest from the vehicle's origin along an axis: the longest road vehicles have 60 m."""
MOST_DEG: Final = 360.0
MOUNT_TEXT: Final = "mount"
"""Name of the metadata text of a recording of packets; in messages a section says it."""
SECTION_BYTES: Final = 96
_FORM: Final = "X,Y,Z,ROLL,PITCH,YAW in metres and degrees"
_ROUNDED: Final = 9
"""Digits after the point of what is computed back from a matrix: a nanometre, and less than a step of any sensor."""


@dataclass(frozen=True)
class Mounting:
    """Position and orientation of a sensor on its vehicle: metres and degrees, rotated by roll, then pitch, then yaw.

    Raises SettingsError for numbers that are not finite, positions beyond 100 m and angles beyond 360 degrees.
    """

    x_m: float = 0.0
    y_m: float = 0.0
    z_m: float = 0.0
    roll_deg: float = 0.0
    pitch_deg: float = 0.0
    yaw_deg: float = 0.0

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            most = MOST_M if name.endswith("_m") else MOST_DEG
            if not isinstance(value, int | float) or isinstance(value, bool):
                raise SettingsError(f"{name} of a mounting is {str(value)[:40]!r}, not a number", "mount")
            if not abs(value) <= most:  # NaN is not
                shown = f"{value:g}" if isinstance(value, float) else f"{value if abs(value) < 10**9 else 'huge'}"
                raise SettingsError(f"{name} of a mounting is {shown}; it must be from -{most:g} to {most:g}", "mount")
            object.__setattr__(self, name, float(value))

    @classmethod
    def parse(cls, text: str) -> Mounting:
        """From `X,Y,Z,ROLL,PITCH,YAW`. Raises SettingsError."""
        try:
            numbers = [float(part) for part in text.split(",")]
        except ValueError:
            numbers = []
        if len(numbers) != len(NAMES):
            raise SettingsError(f"a mounting is {_FORM}, not '{text[:80]}'", "mount")
        return cls(*numbers)

    @classmethod
    def of_values(cls, value: object) -> Mounting:
        """From a text, a list of six numbers, or a mapping of the names of the fields; fields left out are 0.

        Raises SettingsError for anything else.
        """
        if isinstance(value, str):
            return cls.parse(value)
        if isinstance(value, Sequence) and len(value) == len(NAMES):
            return cls(*value)
        if isinstance(value, Mapping) and value and all(name in NAMES for name in value):
            return cls(**value)
        raise SettingsError(f"a mounting is {_FORM}, or some of {', '.join(NAMES)}, not {str(value)[:80]!r}", "mount")

    @classmethod
    def of_matrix(cls, T_vehicle_sensor: Matrix) -> Mounting:
        """From a rigid transform, (4, 4). Straight up or down, yaw is 0 and roll has all of the turn.

        Raises SettingsError for positions beyond 100 m.
        """
        T = T_vehicle_sensor
        pitch = math.atan2(-T[2, 0], math.hypot(T[0, 0], T[1, 0]))
        if math.hypot(T[0, 0], T[1, 0]) > 1e-9:
            roll, yaw = math.atan2(T[2, 1], T[2, 2]), math.atan2(T[1, 0], T[0, 0])
        else:
            roll, yaw = math.atan2(-T[1, 2], T[1, 1]), 0.0
        angles = [math.degrees(angle) for angle in (roll, pitch, yaw)]
        return cls(*(round(float(value), _ROUNDED) + 0.0 for value in (*T[:3, 3], *angles)))

    @cached_property
    def T_vehicle_sensor(self) -> Matrix:
        """(4, 4) float64, read-only: Rz(yaw) Ry(pitch) Rx(roll), and the position."""
        T = transform_of(*self.numbers)
        T.flags.writeable = False
        return T

    @property
    def numbers(self) -> tuple[float, float, float, float, float, float]:
        """The six numbers in the order of `--mount`."""
        return self.x_m, self.y_m, self.z_m, self.roll_deg, self.pitch_deg, self.yaw_deg

    def values(self) -> dict[str, float]:
        """Numbers by name, as in a status."""
        return dict(zip(NAMES, self.numbers, strict=True))

    def __str__(self) -> str:
        return ",".join(f"{number:.12g}" for number in self.numbers)


def transform_of(x: float, y: float, z: float, roll_deg: float, pitch_deg: float, yaw_deg: float) -> Matrix:
    """(4, 4) float64: Rz(yaw) Ry(pitch) Rx(roll), as in ROS (REP 103), and the position in metres."""
    roll, pitch, yaw = np.radians((roll_deg, pitch_deg, yaw_deg))
    (sr, cr), (sp, cp), (sy, cy) = ((np.sin(a), np.cos(a)) for a in (roll, pitch, yaw))
    T = np.eye(4)
    T[:3, :3] = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    T[:3, 3] = x, y, z
    return T


def encode_mount(T_vehicle_sensor: Matrix) -> bytes:
    """The data of a MOUNT section: twelve float64 in row order. Raises SectionError for what no reader takes."""
    return _checked(T_vehicle_sensor)[:3].astype("<f8").tobytes()


def decode_mount(data: bytes) -> Matrix:
    """(4, 4) float64, T_vehicle_sensor of a MOUNT section. Raises SectionError."""
    if len(data) != SECTION_BYTES:
        raise SectionError(f"a mounting of {len(data)} bytes, not {SECTION_BYTES}")
    return _checked(np.vstack([np.frombuffer(data, "<f8").reshape(3, 4), [0.0, 0.0, 0.0, 1.0]]).astype(np.float64))


def _checked(T: Matrix) -> Matrix:
    turn = T[:3, :3]
    if not np.isfinite(T).all() or np.abs(T[:3, 3]).max() > MOST_M or np.abs(turn).max() > 2.0:
        raise SectionError(f"a mounting beyond {MOST_M:g} m, or with numbers that are not finite")
    if np.abs(turn @ turn.T - np.eye(3)).max() > 1e-6 or np.linalg.det(turn) < 0:
        raise SectionError("a mounting that is not a rigid transform")
    return T


def vehicle_pose(pose: Matrix, mount: Matrix | None) -> Matrix:
    """(4, 4) T_world_vehicle of a pose T_world_sensor and a mounting; without one, the sensor is the vehicle."""
    if mount is None:
        return pose
    found: Matrix = pose @ np.linalg.inv(mount)
    return found


def is_same(one: Matrix | None, other: Matrix | None) -> bool:
    """Whether two mountings of frames, each None or (4, 4), are equal."""
    return one is other or (one is not None and other is not None and bool(np.array_equal(one, other)))
