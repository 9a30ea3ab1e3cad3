"""The mask that was sent a turn ago, looked up by azimuth: the same for whole turns, slabs and frames of any width.

A table of 2000 directions (0.18 degree, a little more than an HDL-64E's step between firings) holds, for each row, what
was last sent in that direction. Rows of the two blocks are looked up by the azimuth of their own block.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.sensor_model import SensorModel
from lidarcodec.units import AZIMUTH_TURN, LASERS, LASERS_PER_BLOCK

DIRECTION_STEP: Final = 18
"""Azimuth steps of 0.01 degree in a direction."""
DIRECTIONS: Final = AZIMUTH_TURN // DIRECTION_STEP

Mask = npt.NDArray[np.bool_]


class MaskHistory:
    """What was last sent in each direction. Encoder and decoder keep one each, in step."""

    def __init__(self) -> None:
        self._sent: Mask = np.zeros((LASERS, DIRECTIONS), np.bool_)

    def before(self, azimuth: npt.NDArray[np.uint16], sensor: SensorModel) -> Mask:
        """(64, W) bool, what was last sent in the direction of each cell. azimuth: (2, W) uint16, below 36000."""
        seen = np.empty((LASERS, azimuth.shape[1]), np.bool_)
        for rows, directions in self._halves(azimuth, sensor):
            seen[rows] = np.take(self._sent[rows], directions, axis=1)
        return seen

    def remember(self, valid: Mask, azimuth: npt.NDArray[np.uint16], sensor: SensorModel) -> None:
        """Takes a mask that was sent, (64, W) bool; of columns in one direction the last one stays."""
        for rows, directions in self._halves(azimuth, sensor):
            if not len(directions):
                continue
            last = np.full(DIRECTIONS, -1)
            last[directions] = np.arange(len(directions))  # NumPy: of equal indices the last value stays
            newest = np.take(valid[rows], np.maximum(last, 0), axis=1)
            self._sent[rows] = np.where(last >= 0, newest, self._sent[rows])

    @staticmethod
    def _halves(
        azimuth: npt.NDArray[np.uint16], sensor: SensorModel
    ) -> list[tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]]:
        lower = sensor.laser_of_ring >= LASERS_PER_BLOCK
        directions = (azimuth // DIRECTION_STEP).astype(np.intp)
        return [(np.flatnonzero(~lower), directions[0]), (np.flatnonzero(lower), directions[1])]
