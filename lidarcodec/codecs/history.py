"""What a stream has shown since its last key frame, looked up by azimuth: the same for turns, slabs and any width.

Encoder and decoder keep one of each, in step. `MaskHistory` is what masks refer to: a table of 2000 directions (0.18
degree, a little more than an HDL-64E's step between firings) holds, for each row, what was last sent in that direction.
Rows of the two blocks are looked up by the azimuth of their own block. `StreamHistory` is what ranges refer to.
"""

from __future__ import annotations

from typing import Final, Protocol

import numpy as np
import numpy.typing as npt

from lidarcodec.codecs.motion import Motion
from lidarcodec.codecs.warp import RangeHistory
from lidarcodec.sensor_model import SensorModel
from lidarcodec.units import AZIMUTH_TURN, LASERS, LASERS_PER_BLOCK

DIRECTION_STEP: Final = 18
"""Azimuth steps of 0.01 degree in a direction."""
DIRECTIONS: Final = AZIMUTH_TURN // DIRECTION_STEP

Mask = npt.NDArray[np.bool_]
Ranges = npt.NDArray[np.uint16]


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


class Memory(Protocol):
    """What a coder of ranges learns from frame to frame."""

    def reset(self) -> None:
        """Forget it, as before a key frame."""


class StreamHistory:
    """What ranges refer to: what their coder has learned, and the ranges of the last turn in every direction.

    memory: of the codec; it learns by itself, and is reset here
    """

    def __init__(self, memory: Memory) -> None:
        self._memory = memory
        self.seen = RangeHistory()

    def forget(self) -> None:
        """Forgets everything, before a message that needs no other."""
        self._memory.reset()
        self.seen.forget()

    def expected(self, motion: Motion, azimuth: Ranges, fired: Mask, sensor: SensorModel) -> Ranges:
        """(64, W) uint16, what a frame should look like if the sensor moved so: `RangeHistory.expected`."""
        return self.seen.expected(motion, azimuth, fired, sensor)

    def remember(self, ranges: Ranges, azimuth: Ranges, fired: Mask, sensor: SensorModel) -> None:
        """Takes a frame that was sent, (64, W) uint16 as it is decoded, 0 outside of its returns."""
        self.seen.remember(ranges, azimuth, fired, sensor)
