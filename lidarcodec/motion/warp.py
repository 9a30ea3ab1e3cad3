"""The expected ranges of a frame: the ranges of the last turn, transformed by the sensor's motion.

The history has every return of the last turn with its azimuth, so frames may begin anywhere: whole turns, 348 packets,
or slabs. Returns become points, and the motion transforms them. In each direction a polyline through the rings makes
them a surface. The beams of the new frame intersect that surface. This is exact on planes such as the road, where the
nearest ring would be wrong by a fortieth of the range. All computation is in integers, so that encoder and decoder
agree on any machine. docs/wire-format-motion.md has the rules.

>>> from lidarcodec.sensor_model import Calibration, SensorModel
>>> sensor = SensorModel("HDL-64E", Calibration.from_values({"vert_correction_rad": np.linspace(0.03, -0.43, 64)}))
>>> azimuth, fired = np.tile(np.arange(0, 360, 18, dtype=np.uint16), (2, 1)), np.ones((2, 20), bool)
>>> history = RangeHistory()
>>> history.remember(np.full((64, 20), 5000, np.uint16), azimuth, fired, sensor)
>>> int(history.expected(STILL, azimuth, fired, sensor)[30, 10])
5000
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec import _native
from lidarcodec.errors import SectionError
from lidarcodec.motion.motion import STILL, Motion
from lidarcodec.sensor_model import CALIBRATION_FIELDS, SensorModel
from lidarcodec.units import AZIMUTH_TURN, LASERS, LASERS_PER_BLOCK, MAX_COLUMNS

__all__ = ["STILL", "RangeHistory", "beam_rows", "swept"]

_FIELDS: Final = list(CALIBRATION_FIELDS)
_USED: Final = ("rot_correction_rad", "vert_correction_rad", "dist_correction_m", "vert_offset_m", "horiz_offset_m")

Ranges = npt.NDArray[np.uint16]
Mask = npt.NDArray[np.bool_]


@lru_cache(maxsize=8)
def beam_rows(sensor: SensorModel) -> npt.NDArray[np.int32]:
    """(6, 64) int32: for each row its block (0 upper, 1 lower) and five values of its laser's calibration."""
    lasers = sensor.laser_of_ring
    table = sensor.calibration.table[[_FIELDS.index(name) for name in _USED]][:, lasers]
    rows = np.ascontiguousarray(np.concatenate([(lasers >= LASERS_PER_BLOCK)[None].astype(np.int32), table]))
    rows.flags.writeable = False
    return rows


class RangeHistory:
    """The last ranges in each direction; 0.6 MB."""

    def __init__(self, native: _native.RangeHistory | None = None) -> None:
        self.native: Final = native or _native.RangeHistory()

    def copy(self) -> RangeHistory:
        """Another one that has stored the same."""
        return RangeHistory(self.native.copy())

    def forget(self) -> None:
        """Forget everything, before a key frame."""
        self.native.forget()

    def remember(self, ranges: Ranges, azimuth: Ranges, fired: Mask, sensor: SensorModel) -> None:
        """Store a sent frame after decoding; 0.4 ms a turn.

        ranges: (64, W) uint16, 0 = no return; azimuth: (2, W) uint16, 0.01 degree; fired: (2, W) bool
        Raises SectionError if shapes do not fit or an azimuth is not below 36000.
        """
        azimuth, fired8 = _columns(azimuth, fired)
        if ranges.dtype != np.uint16 or ranges.shape != (LASERS, azimuth.shape[1]):
            raise SectionError(f"ranges are {ranges.dtype}{ranges.shape}, not uint16{(LASERS, azimuth.shape[1])}")
        self.native.remember(np.ascontiguousarray(ranges), azimuth, fired8, beam_rows(sensor))

    def expected(self, motion: Motion, azimuth: Ranges, fired: Mask, sensor: SensorModel) -> Ranges:
        """(64, W) uint16, the expected range of each cell of a frame, 0 if unknown.

        motion: motion of the sensor since the stored ranges were measured; azimuth, fired: of the frame, as in
        `remember`
        Raises SectionError as `remember`.
        """
        azimuth, fired8 = _columns(azimuth, fired)
        expected: Ranges = self.native.expected(motion.numbers, azimuth, fired8, beam_rows(sensor))
        return expected


def swept(azimuth: Ranges) -> int:
    """Azimuth steps from the first column of a frame to its last. azimuth: (2, W) uint16, below 36000."""
    upper = azimuth[0]
    if not len(upper):
        return 0
    turns = int(np.count_nonzero(upper[1:] < upper[:-1]))
    return int(upper[-1]) - int(upper[0]) + AZIMUTH_TURN * turns


def _columns(azimuth: Ranges, fired: Mask) -> tuple[Ranges, npt.NDArray[np.uint8]]:
    width = fired.shape[-1] if fired.ndim == 2 else -1
    if width > MAX_COLUMNS:
        raise SectionError(f"a frame of {width} columns: the limit is {MAX_COLUMNS}")
    for name, array, dtype in (("azimuth", azimuth, np.uint16), ("fired", fired, np.bool_)):
        if array.dtype != dtype or array.shape != (2, width):
            raise SectionError(f"{name} is {array.dtype}{array.shape}, not {np.dtype(dtype)}{(2, width)}")
    return np.ascontiguousarray(azimuth), np.ascontiguousarray(fired).view(np.uint8)
