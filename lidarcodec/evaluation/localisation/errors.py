"""Errors of estimated poses: the paper's Trans mATE, Rot mAPE and mAPE, as defined by the tool `evo`.

With E = inverse(reference) estimate:

    Trans mATE   mean of |translation of E|                        metres
    Rot mAPE     mean of the Frobenius norm of (rotation of E - I) no unit; 2 sqrt(2) sin(angle / 2)
    mAPE         mean of the Frobenius norm of (E - I)             sqrt(Trans^2 + Rot^2) for one pose

In addition the angle of E in degrees, which is easier to imagine.

>>> off = np.eye(4)
>>> off[0, 3] = 0.03
>>> errors = pose_errors(off[None], np.eye(4)[None])
>>> float(errors["trans_m"][0]), float(errors["ape"][0]), float(errors["angle_deg"][0])
(0.03, 0.03, 0.0)
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from lidarcodec.evaluation.rigid import Matrix, invert, log_so3

FIELDS: Final = ("trans_m", "rot", "ape", "angle_deg")
DRAWS: Final = 1000


def pose_errors(estimates: Matrix, references: Matrix) -> dict[str, Matrix]:
    """Each error in FIELDS as (N,), for estimates (N, 4, 4) and references (N, 4, 4)."""
    off = invert(references) @ estimates
    return {
        "trans_m": np.linalg.norm(off[:, :3, 3], axis=1),
        "rot": np.linalg.norm(off[:, :3, :3] - np.eye(3), axis=(1, 2)),
        "ape": np.linalg.norm(off - np.eye(4), axis=(1, 2)),
        "angle_deg": np.degrees(np.linalg.norm(log_so3(off[:, :3, :3]), axis=1)),
    }


def standard_error(values: Matrix, seed: int) -> float | None:
    """Standard error of the mean by bootstrap over the values; None for fewer than two."""
    if len(values) < 2:
        return None
    random = np.random.default_rng(seed)
    draws = random.integers(0, len(values), (DRAWS, len(values)))
    return float(np.std(values[draws].mean(axis=1)))


def error_over_drives(drives: list[Matrix], seed: int) -> float | None:
    """Standard error of the mean over drives, by bootstrap over drives and then over frames; None for fewer than two
    drives.

    It is the error of the mean of the drives' means, so long and short drives have the same weight.
    """
    if len(drives) < 2:
        return None
    random = np.random.default_rng(seed)
    means = np.empty(DRAWS)
    for draw in range(DRAWS):
        chosen = [drives[at] for at in random.integers(0, len(drives), len(drives))]
        means[draw] = np.mean([values[random.integers(0, len(values), len(values))].mean() for values in chosen])
    return float(np.std(means))


def summary(errors: dict[str, Matrix], counted: Any, seed: int) -> dict[str, Any]:
    """Means `mate_m`, `rot_mape`, `mape` and `angle_deg` over the counted poses, and the number of the others. counted:
    (N,) bool"""
    if not np.any(counted):
        return {"mate_m": None, "mate_m_error": None, "rot_mape": None, "mape": None, "angle_deg": None}
    return {
        "mate_m": float(errors["trans_m"][counted].mean()),
        "mate_m_error": standard_error(errors["trans_m"][counted], seed),
        "rot_mape": float(errors["rot"][counted].mean()),
        "mape": float(errors["ape"][counted].mean()),
        "angle_deg": float(errors["angle_deg"][counted].mean()),
    }
