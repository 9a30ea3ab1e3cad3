"""Rigid transforms as arrays: inverses, rotation vectors, transformed points.

>>> turn = exp_so3(np.array([0.0, 0.0, np.pi / 2]))
>>> log_so3(turn[None])[0].round(6).tolist()
[0.0, 0.0, 1.570796]
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Matrix = npt.NDArray[np.float64]


def moved(transform: Matrix, points: Matrix) -> Matrix:
    """(N, 3) points transformed by a (4, 4) transform."""
    # not with @: for such a small product BLAS threads wait for each other longer than they compute
    there: Matrix = np.einsum("ij,kj->ik", points, transform[:3, :3])
    there += transform[:3, 3]
    return there


def invert(transforms: Matrix) -> Matrix:
    """(..., 4, 4) inverses of rigid transforms."""
    back = np.swapaxes(transforms[..., :3, :3], -1, -2)
    inverse = np.zeros_like(transforms)
    inverse[..., :3, :3] = back
    inverse[..., :3, 3] = -np.einsum("...ij,...j->...i", back, transforms[..., :3, 3])
    inverse[..., 3, 3] = 1.0
    return inverse


def exp_so3(vector: Matrix) -> Matrix:
    """(3, 3) rotation about the vector (3,), by its length in radians."""
    angle = float(np.linalg.norm(vector))
    x, y, z = vector
    spin = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    if angle < 1e-8:
        once, twice = 1.0, 0.5
    else:
        once, twice = np.sin(angle) / angle, (1.0 - np.cos(angle)) / angle**2
    rotation: Matrix = np.eye(3) + once * spin + twice * (spin @ spin)
    return rotation


def log_so3(rotations: Matrix) -> Matrix:
    """(F, 3) rotation vectors of (F, 3, 3), for angles slightly less than half a turn."""
    axis = np.stack([rotations[:, 2, 1] - rotations[:, 1, 2], rotations[:, 0, 2] - rotations[:, 2, 0],
                     rotations[:, 1, 0] - rotations[:, 0, 1]], axis=1) / 2  # fmt: skip
    sine = np.linalg.norm(axis, axis=1)
    angle = np.arctan2(sine, (np.trace(rotations, axis1=1, axis2=2) - 1) / 2)
    scale = np.where(sine > 1e-9, angle / np.maximum(sine, 1e-12), 1.0)
    vectors: Matrix = axis * scale[:, None]
    return vectors
