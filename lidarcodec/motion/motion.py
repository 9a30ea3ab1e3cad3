"""Motion: the motion of a sensor within a turn, in integers, and its MOTION section.

A rotation is sent as its Cayley vector h: its direction is the axis, and its length the tangent of half the angle. So
any three numbers are a valid rotation, and every machine computes the same matrix from them:
R = 1 + 2 (S [h] + [h]^2) / (S^2 + h.h) with S = 2^24. The section is described in docs/wire-format-motion.md.

>>> ahead = Motion(shift=(-16_000, 0, 0))  # the sensor drove a metre ahead: points move a metre back
>>> encode_motion(ahead)[9:12].hex()
'80c1ff'
>>> ahead.numbers.tolist()[9:]
[-16000, 0, 0]
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import SectionError

CAYLEY_UNIT: Final = 1 << 24
"""Number of steps of a Cayley vector in 1."""
SHIFT_UNIT_M: Final = 0.0000625
"""Step of a shift in metres: 1/16 mm. A range step of 2 mm is 32 of them."""
MAX_CAYLEY: Final = 1 << 22
"""Largest component of a Cayley vector: 28 degrees within a turn."""
MAX_SHIFT: Final = 320_000
"""Largest component of a shift: 20 m within a turn."""
ROTATION_UNIT: Final = 1 << 30
_BYTES: Final = 3
_MAX_NON_ORTHOGONALITY: Final = 0.1
"""Largest difference of an element of R R^T from the identity matrix. Other programs round the poses that they
write."""
_MAX_M: Final = 1e9

Triple = tuple[int, int, int]
Matrix = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Motion:
    """T_current_previous: transforms points from the sensor's frame of a turn ago to its present frame.

    turn: Cayley vector in steps of 2^-24, components up to MAX_CAYLEY; shift: in steps of 1/16 mm, up to MAX_SHIFT
    Raises SectionError beyond the limits.
    """

    turn: Triple = (0, 0, 0)
    shift: Triple = (0, 0, 0)

    def __post_init__(self) -> None:
        if max(map(abs, self.turn)) > MAX_CAYLEY or max(map(abs, self.shift)) > MAX_SHIFT:
            raise SectionError(f"the motion {self.turn}, {self.shift} exceeds the limits of 28 degrees and 20 m")

    @classmethod
    def nearest(cls, matrix: Matrix) -> Motion | None:
        """The motion closest to a (4, 4) transform in metres; None if it is not rigid, or beyond the limits."""
        turn = matrix[:3, :3]
        scale = 1.0 + np.trace(turn)
        if not np.isfinite(matrix).all() or scale < 1.0:
            return None
        axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
        cayley, shift = np.rint(axis / scale * CAYLEY_UNIT), np.rint(matrix[:3, 3] / SHIFT_UNIT_M)
        if max(abs(cayley)) > MAX_CAYLEY or max(abs(shift)) > MAX_SHIFT:
            return None
        return cls(_triple(cayley), _triple(shift))

    @property
    def numbers(self) -> npt.NDArray[np.int32]:
        """(12,) int32: the rotation matrix row by row in steps of 2^-30, then the shift."""
        x, y, z = self.turn
        square = x * x + y * y + z * z
        scale = CAYLEY_UNIT * CAYLEY_UNIT + square
        spin = ((0, -z, y), (z, 0, -x), (-y, x, 0))
        rotation = []
        for i, row in enumerate(spin):
            for j, part in enumerate(row):
                squared = self.turn[i] * self.turn[j] - (square if i == j else 0)  # of [h]^2 = h h' - h.h
                turned = 2 * (CAYLEY_UNIT * part + squared) + (scale if i == j else 0)
                rotation.append((2 * turned * ROTATION_UNIT + scale) // (2 * scale))
        return np.array([*rotation, *self.shift], np.int32)

    @property
    def matrix(self) -> Matrix:
        """(4, 4) float64, T_current_previous in metres."""
        numbers = self.numbers
        matrix = np.eye(4)
        matrix[:3, :3] = numbers[:9].reshape(3, 3) / ROTATION_UNIT
        matrix[:3, 3] = numbers[9:] * SHIFT_UNIT_M
        return matrix

    def scaled(self, factor: float) -> Motion | None:
        """The motion at the same velocity in `factor` times the time; None if it is beyond the limits."""
        turn, shift = np.rint(np.array(self.turn) * factor), np.rint(np.array(self.shift) * factor)
        if not (max(abs(turn)) <= MAX_CAYLEY and max(abs(shift)) <= MAX_SHIFT):
            return None
        return Motion(_triple(turn), _triple(shift))


STILL: Final = Motion()


def _triple(values: npt.NDArray[np.float64]) -> Triple:
    x, y, z = (int(value) for value in values)
    return x, y, z


def is_rigid(pose: npt.NDArray[np.float64]) -> bool:
    """Whether a (4, 4) matrix is a rotation, up to rounding, and a shift of less than 10^9 m."""
    if not (np.isfinite(pose).all() and np.abs(pose).max() < _MAX_M) or pose[3].tolist() != [
        0.0,
        0.0,
        0.0,
        1.0,
    ]:
        return False
    turn = pose[:3, :3]
    return bool(np.abs(turn @ turn.T - np.eye(3)).max() < _MAX_NON_ORTHOGONALITY and np.linalg.det(turn) > 0)


def encode_motion(motion: Motion) -> bytes:
    """The 18 bytes of a MOTION section: turn and shift, 3 bytes each number, signed, little endian."""
    return b"".join(number.to_bytes(_BYTES, "little", signed=True) for number in (*motion.turn, *motion.shift))
