"""What a stream has shown since its last key frame, looked up by azimuth: the same for turns, slabs and any width.

Encoder and decoder keep one of each, in step. `MaskHistory` is what masks refer to: a table of 2000 directions (0.18
degree, a little more than an HDL-64E's step between firings) holds, for each row, what was last sent in that direction.
Rows of the two blocks are looked up by the azimuth of their own block. `StreamHistory` is what ranges refer to.
"""

from __future__ import annotations

from collections import deque
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec.entropy import KnownColumns
from lidarcodec.motion.motion import Motion
from lidarcodec.motion.warp import RangeHistory, swept
from lidarcodec.sensor_model import SensorModel
from lidarcodec.units import AZIMUTH_TURN, LASERS, LASERS_PER_BLOCK

DIRECTION_STEP: Final = 18
"""Azimuth steps of 0.01 degree in a direction."""
DIRECTIONS: Final = AZIMUTH_TURN // DIRECTION_STEP
EDGE_COLUMNS: Final = 128
"""Columns before a slab that it may look at: more than the rows of an HDL-64E lie apart."""
WIDEST_GAP: Final = 500
"""Azimuth steps that may be missing before a slab for which the columns before it are of use."""
WAITING_SWEEP: Final = 3600
WAITING_COLUMNS: Final = 1024
"""Azimuth steps, or columns, that must have been sent after a slab before it is remembered as the last turn."""

Mask = npt.NDArray[np.bool_]
Ranges = npt.NDArray[np.uint16]


class MaskHistory:
    """What was last sent in each direction. Encoder and decoder keep one each, in step."""

    def __init__(self) -> None:
        self._sent: Mask = np.zeros((DIRECTIONS, LASERS), np.bool_)  # a column's rows beside each other

    def before(self, azimuth: npt.NDArray[np.uint16], sensor: SensorModel) -> Mask:
        """(64, W) bool, what was last sent in the direction of each cell. azimuth: (2, W) uint16, below 36000."""
        if not self._sent.any():  # a covered sensor costs little, and a message that says nothing, too
            return np.zeros((LASERS, azimuth.shape[1]), np.bool_)
        seen = np.empty((LASERS, azimuth.shape[1]), np.bool_)
        for rows, directions in self._halves(azimuth, sensor):
            seen[rows] = self._sent[directions][:, rows].T
        return seen

    def remember(self, valid: Mask, azimuth: npt.NDArray[np.uint16], sensor: SensorModel) -> None:
        """Takes a mask that was sent, (64, W) bool; of columns in one direction the last one stays."""
        if not valid.any() and not self._sent.any():
            return
        for rows, directions in self._halves(azimuth, sensor):
            at = directions if isinstance(rows, slice) else directions[:, None]
            self._sent[at, rows] = valid[rows].T  # NumPy: of equal indices the last value stays

    @staticmethod
    def _halves(
        azimuth: npt.NDArray[np.uint16], sensor: SensorModel
    ) -> list[tuple[slice | npt.NDArray[np.intp], npt.NDArray[np.intp]]]:
        lower = sensor.laser_of_ring >= LASERS_PER_BLOCK
        directions = (azimuth // DIRECTION_STEP).astype(np.intp)
        return [(_together(np.flatnonzero(~lower)), directions[0]), (_together(np.flatnonzero(lower)), directions[1])]


def _together(rows: npt.NDArray[np.intp]) -> slice | npt.NDArray[np.intp]:
    """Rows as a slice if they lie beside each other, as those of a block mostly do: four times as quick."""
    return slice(int(rows[0]), int(rows[-1]) + 1) if rows[-1] - rows[0] + 1 == len(rows) else rows


class _Sent(NamedTuple):
    ranges: Ranges
    azimuth: Ranges
    fired: Mask
    sensor: SensorModel
    swept: int | None  # azimuth steps of a slab; None: a whole frame


class StreamHistory:
    """What ranges refer to: the ranges of the last turn, and the columns before a slab."""

    def __init__(self) -> None:
        self._seen = RangeHistory()
        self._edge = KnownColumns.none()  # the last columns, up to EDGE_COLUMNS, if slabs were sent last
        self._edge_azimuth: int | None = None
        self._waiting: deque[_Sent] = deque()

    def forget(self) -> None:
        """Forgets everything, before a key message."""
        self._seen.forget()
        self._waiting.clear()
        self.forget_edge()

    @property
    def seen(self) -> RangeHistory:
        """The ranges of the last turn."""
        self._take_waiting()
        return self._seen

    def expected(self, motion: Motion, azimuth: Ranges, fired: Mask, sensor: SensorModel) -> Ranges:
        """(64, W) uint16, what a frame should look like if the sensor moved so: `RangeHistory.expected`."""
        return self.seen.expected(motion, azimuth, fired, sensor)

    def remember(self, ranges: Ranges, azimuth: Ranges, fired: Mask, sensor: SensorModel, *, slab: bool) -> None:
        """Takes a frame that was sent, (64, W) uint16 as it is decoded, 0 outside of its returns.

        A slab waits until enough was sent after it: what is to be expected on the left of a slab was then seen a turn
        ago as all the rest was, and not a moment ago, from where the sensor is now. All else waits for the next frame
        or question, so that a stream of key frames pays nothing for it.
        """
        self._take_waiting()
        self._waiting.append(_Sent(ranges, azimuth, fired, sensor, swept(azimuth) if slab else None))

    def _take_waiting(self) -> None:
        slab = bool(self._waiting) and self._waiting[-1].swept is not None
        sweep = sum(sent.swept or 0 for sent in self._waiting)
        columns = sum(sent.ranges.shape[1] for sent in self._waiting)
        while self._waiting:
            sweep -= self._waiting[0].swept or 0
            columns -= self._waiting[0].ranges.shape[1]
            if slab and sweep < WAITING_SWEEP and columns < WAITING_COLUMNS:
                break
            self._seen.remember(*self._waiting.popleft()[:4])

    def remember_edge(self, ranges: Ranges, azimuth: Ranges, fired: Mask, expected: Ranges | None) -> None:
        """Takes the columns of a slab, as they are decoded, and what was expected of them."""
        foreseen = np.zeros_like(ranges) if expected is None else expected
        self._edge = self._edge.and_then(KnownColumns(ranges, fired, foreseen)).last(EDGE_COLUMNS)
        self._edge_azimuth = int(azimuth[0, -1])

    def forget_edge(self) -> None:
        """Forgets the columns of slabs, after a whole frame."""
        self._edge, self._edge_azimuth = KnownColumns.none(), None

    def edge_before(self, azimuth: Ranges) -> KnownColumns:
        """The columns to use before a slab, none if too much is missing between; azimuth: (2, W) uint16 of the slab."""
        if self._edge_azimuth is None or not azimuth.shape[1]:
            return KnownColumns.none()
        gap = (int(azimuth[0, 0]) - self._edge_azimuth) % AZIMUTH_TURN
        return self._edge if gap <= WIDEST_GAP else KnownColumns.none()
