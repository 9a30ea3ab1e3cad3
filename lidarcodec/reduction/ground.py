"""Returns on the ground of any sensor's frame, as native/src/reduction/seen_before.cpp finds them for an HDL-64E.

In each of 128 sectors the ground is the surface that goes on outwards from the vehicle without a step.

>>> flat = np.array([[x, y, -1.7] for x in range(-9, 10) for y in range(-9, 10)], np.float32)
>>> post = np.array([[6, 6, 0]], np.float32)
>>> int(ground_of(flat).sum()), int(ground_of(np.concatenate([flat, post]))[-1])
(361, 0)
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

SECTORS: Final = 128
RINGS: Final = 42
"""Of a metre each."""
_NEAR: Final = slice(3, 12)
"""Rings whose lowest returns tell how high the sensor is."""
_STEP_M, _GRADIENT = 0.15, 0.12
_HEIGHT_M: Final = 0.25
"""Returns less high above the ground count as ground."""


def ground_of(points: npt.NDArray[np.float32]) -> npt.NDArray[np.uint8]:
    """(N,) uint8, 1 for each return on the ground. points: (N, 3), metres, from the sensor; 10 ms for 100,000."""
    x, y, z = points.T
    away = np.hypot(x, y)
    inside = (away < RINGS) & (np.abs(z) < 100.0)
    sector = ((np.arctan2(y, x) / (2 * np.pi) + 1.0) * SECTORS).astype(np.int64) % SECTORS
    place = (sector * RINGS + away.astype(np.int64))[inside]
    lowest = np.full(SECTORS * RINGS, np.inf, np.float32)
    np.minimum.at(lowest, place, z[inside])
    rings = lowest.reshape(SECTORS, RINGS)
    near = rings[:, _NEAR][np.isfinite(rings[:, _NEAR])]
    found = np.zeros(len(points), np.uint8)
    if not len(near):
        return found
    followed = _followed(rings, float(np.partition(near, len(near) // 2)[len(near) // 2]))
    found[inside] = z[inside] < followed.reshape(-1)[place] + _HEIGHT_M
    return found


def _followed(lowest: npt.NDArray[np.float32], height: float) -> npt.NDArray[np.float32]:
    """(SECTORS, RINGS), height of the ground, outwards from `height`. lowest: the lowest return of each ring."""
    found = np.empty_like(lowest)
    here = np.full(SECTORS, height, np.float32)
    apart = np.ones(SECTORS, np.float32)
    for ring in range(RINGS):
        goes_on = np.abs(lowest[:, ring] - here) <= _STEP_M + _GRADIENT * apart
        here = np.where(goes_on, lowest[:, ring], here)
        apart = np.where(goes_on, np.float32(1), apart + np.float32(1))
        found[:, ring] = here
    return found
