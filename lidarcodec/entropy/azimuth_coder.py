"""Azimuth coder: the rotation position vector of a frame, without loss.

Two forms. `rotation_runs` is Tu 2016's: differences of the rotation positions, run-length coded; easy to see through,
kept for comparison. `encode_azimuth` is what goes on the wire: the same differences, coded by the lengths of the last
runs (docs/wire-format-sections.md, section "azimuth"), about 50 bytes for the 2088 columns of a KITTI frame.

>>> import numpy as np
>>> runs = rotation_runs(np.array([35982, 0, 18, 36, 45], np.uint16))
>>> runs.first, runs.steps.tolist(), runs.counts.tolist()
(35982, [18, 9], [3, 1])
>>> rotation_from_runs(runs).tolist()
[35982, 0, 18, 36, 45]
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec import _native
from lidarcodec.errors import SectionError
from lidarcodec.units import AZIMUTH_TURN, MAX_COLUMNS


class RotationRuns(NamedTuple):
    """Differences and runs of a rotation vector.

    first: its first position, None if it is empty; steps: (R,) uint16, differences modulo a full turn, no two
    neighbours equal; counts: (R,) uint32, how often each is repeated
    """

    first: int | None
    steps: npt.NDArray[np.uint16]
    counts: npt.NDArray[np.uint32]


def rotation_runs(azimuth: npt.NDArray[np.uint16]) -> RotationRuns:
    """Differences and runs (Tu 2016) of a rotation vector, (W,) uint16, 0.01 degree.

    Raises SectionError if a position is over 35999.
    """
    if azimuth.ndim != 1 or azimuth.dtype != np.uint16 or (len(azimuth) and int(azimuth.max()) >= AZIMUTH_TURN):
        raise SectionError(f"a rotation vector is uint16(W,) below {AZIMUTH_TURN}, not {azimuth.dtype}{azimuth.shape}")
    if not len(azimuth):
        return RotationRuns(None, np.zeros(0, np.uint16), np.zeros(0, np.uint32))
    steps = _steps(azimuth)
    starts = np.flatnonzero(np.diff(steps, prepend=-1))
    counts = np.diff(starts, append=len(steps))
    return RotationRuns(int(azimuth[0]), steps[starts].astype(np.uint16), counts.astype(np.uint32))


def rotation_from_runs(runs: RotationRuns) -> npt.NDArray[np.uint16]:
    """(W,) uint16 rotation vector of its differences and runs.

    Raises SectionError if there are more than a frame's columns, or a step of a full turn.
    """
    if runs.first is None:
        return np.zeros(0, np.uint16)
    total = int(runs.counts.sum(dtype=np.uint64))
    if total >= MAX_COLUMNS or len(runs.steps) != len(runs.counts):
        raise SectionError(
            f"{len(runs.steps)} steps in {len(runs.counts)} runs of {total} columns, limit {MAX_COLUMNS}"
        )
    if not 0 <= runs.first < AZIMUTH_TURN or (len(runs.steps) and int(runs.steps.max()) >= AZIMUTH_TURN):
        raise SectionError("a rotation of a full turn or more")
    steps = np.repeat(runs.steps.astype(np.int64), runs.counts)
    return ((runs.first + np.concatenate([np.zeros(1, np.int64), np.cumsum(steps)])) % AZIMUTH_TURN).astype(np.uint16)


def encode_azimuth(azimuth: npt.NDArray[np.uint16], fired: npt.NDArray[np.bool_]) -> bytes:
    """Bytes of a frame's rotations and of what fired; 0.1 ms a frame.

    azimuth: (2, W) uint16, 0.01 degree, upper and lower; fired: (2, W) bool.

    Raises SectionError if a value is over 35999, or a half that did not fire does not repeat the other.
    """
    width = azimuth.shape[-1] if azimuth.ndim == 2 else -1
    if azimuth.dtype != np.uint16 or azimuth.shape != (2, width) or width > MAX_COLUMNS:
        raise SectionError(f"azimuth is {azimuth.dtype}{azimuth.shape}, not uint16(2, W) with W up to {MAX_COLUMNS}")
    if fired.dtype != np.bool_ or fired.shape != azimuth.shape:
        raise SectionError(f"fired is {fired.dtype}{fired.shape}, not bool{azimuth.shape}")
    return _native.encode_azimuth(np.ascontiguousarray(azimuth), np.ascontiguousarray(fired).view(np.uint8))


def decode_azimuth(data: bytes, width: int) -> tuple[npt.NDArray[np.uint16], npt.NDArray[np.bool_]]:
    """azimuth (2, W) uint16 and fired (2, W) bool; 0.1 ms a frame.

    Raises SectionError or TruncatedError.
    """
    if not 0 <= width <= MAX_COLUMNS:
        raise SectionError(f"a frame of {width} columns: the limit is {MAX_COLUMNS}")
    azimuth, fired = _native.decode_azimuth(data, width)
    return azimuth, fired.view(np.bool_)


def columns_in_turn(azimuth: npt.NDArray[np.uint16]) -> int | None:
    """Columns in a full turn at the mean step of a frame's rotations, (2, W) uint16; gaps are left out.

    None if the sensor does not turn. It tells `encode_mask` how the rows lie to each other.
    """
    return _native.columns_in_turn(np.ascontiguousarray(azimuth[0])) or None


def _steps(azimuth: npt.NDArray[np.uint16]) -> npt.NDArray[np.int64]:
    """(W - 1,) int64 differences of a rotation vector, modulo a full turn."""
    rotation = azimuth.astype(np.int64)
    steps = rotation[1:] - rotation[:-1]
    return np.where(steps < 0, steps + AZIMUTH_TURN, steps)
