"""Histories of a stream since its last key frame, looked up by azimuth, so that frames may have any width.

Encoder and decoder each have the same histories. Masks refer to `MaskHistory`: a table of 2000 directions (0.18
degree, slightly more than an HDL-64E's step between firings) has, for each row, the mask that was last sent in that
direction. Rows of both blocks are looked up by the azimuth of their own block. Ranges refer to `StreamHistory`.
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
"""Number of columns before a slab to which it may refer: more than the azimuth offset between rows of an HDL-64E."""
WIDEST_GAP: Final = 500
"""Most azimuth steps that may be missing between a slab and the columns to which it refers."""
WAITING_SWEEP: Final = 3600
WAITING_COLUMNS: Final = 1024
"""A slab becomes part of the last turn only after so many azimuth steps, or columns, were sent after it."""

Mask = npt.NDArray[np.bool_]
Ranges = npt.NDArray[np.uint16]


class MaskHistory:
    """The mask that was last sent in each direction. Encoder and decoder each have the same."""

    def __init__(self) -> None:
        self._sent: Mask = np.zeros((DIRECTIONS, LASERS), np.bool_)  # the rows of a column are adjacent

    def copy(self) -> MaskHistory:
        """Another one that has stored the same."""
        other = MaskHistory.__new__(MaskHistory)
        other._sent = self._sent.copy()
        return other

    def before(self, azimuth: npt.NDArray[np.uint16], sensor: SensorModel) -> Mask:
        """(64, W) bool, the mask last sent in the direction of each cell. azimuth: (2, W) uint16, below 36000"""
        if not self._sent.any():  # quick for empty masks, for example of a covered sensor
            return np.zeros((LASERS, azimuth.shape[1]), np.bool_)
        seen = np.empty((LASERS, azimuth.shape[1]), np.bool_)
        for rows, directions in self._halves(azimuth, sensor):
            seen[rows] = self._sent[directions][:, rows].T
        return seen

    def remember(self, valid: Mask, azimuth: npt.NDArray[np.uint16], sensor: SensorModel) -> None:
        """Store a sent mask, (64, W) bool. If several columns have the same direction, the last one is stored."""
        if not valid.any() and not self._sent.any():
            return
        for rows, directions in self._halves(azimuth, sensor):
            at = directions if isinstance(rows, slice) else directions[:, None]
            self._sent[at, rows] = valid[rows].T  # NumPy: for equal indices the last value is stored

    @staticmethod
    def _halves(
        azimuth: npt.NDArray[np.uint16], sensor: SensorModel
    ) -> list[tuple[slice | npt.NDArray[np.intp], npt.NDArray[np.intp]]]:
        lower = sensor.laser_of_ring >= LASERS_PER_BLOCK
        directions = (azimuth // DIRECTION_STEP).astype(np.intp)
        return [(_together(np.flatnonzero(~lower)), directions[0]), (_together(np.flatnonzero(lower)), directions[1])]


def _together(rows: npt.NDArray[np.intp]) -> slice | npt.NDArray[np.intp]:
    """Rows as a slice if they are adjacent, as usual in a block: four times as fast."""
    return slice(int(rows[0]), int(rows[-1]) + 1) if rows[-1] - rows[0] + 1 == len(rows) else rows


class _Sent(NamedTuple):
    ranges: Ranges
    azimuth: Ranges
    fired: Mask
    sensor: SensorModel
    swept: int | None  # azimuth steps of a slab; None: a whole frame


class StreamHistory:
    """The reference of ranges: the ranges of the last turn, and the columns before a slab."""

    def __init__(self) -> None:
        self._seen = RangeHistory()
        self._edge = KnownColumns.none()  # the last columns, up to EDGE_COLUMNS, if slabs were sent last
        self._edge_azimuth: int | None = None
        self._waiting: deque[_Sent] = deque()

    def copy(self) -> StreamHistory:
        """Another one that has stored the same."""
        other = StreamHistory.__new__(StreamHistory)
        other._seen, other._waiting = self._seen.copy(), self._waiting.copy()
        other._edge, other._edge_azimuth = self._edge, self._edge_azimuth
        return other

    def forget(self) -> None:
        """Forget everything, before a key message."""
        self._seen.forget()
        self._waiting.clear()
        self.forget_edge()

    @property
    def seen(self) -> RangeHistory:
        """The ranges of the last turn."""
        self._take_waiting()
        return self._seen

    def expected(self, motion: Motion, azimuth: Ranges, fired: Mask, sensor: SensorModel) -> Ranges:
        """(64, W) uint16, the expected ranges of a frame after this motion: `RangeHistory.expected`."""
        return self.seen.expected(motion, azimuth, fired, sensor)

    def remember(self, ranges: Ranges, azimuth: Ranges, fired: Mask, sensor: SensorModel, *, slab: bool) -> None:
        """Store a sent frame, (64, W) uint16 decoded ranges, 0 without a return.

        A slab waits until enough was sent after it. Then the expected ranges left of a slab are also a turn old, like
        all others, and not measured just before from the present pose. A whole frame waits for the next frame or call
        of `expected`, so that a stream of key frames has no cost.
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
        """Store the decoded columns of a slab, and their expected ranges."""
        foreseen = np.zeros_like(ranges) if expected is None else expected
        self._edge = self._edge.and_then(KnownColumns(ranges, fired, foreseen)).last(EDGE_COLUMNS)
        self._edge_azimuth = int(azimuth[0, -1])

    def forget_edge(self) -> None:
        """Forget the columns of slabs, after a whole frame."""
        self._edge, self._edge_azimuth = KnownColumns.none(), None

    def edge_before(self, azimuth: Ranges) -> KnownColumns:
        """The columns before a slab; none if too many are missing in between. azimuth: (2, W) uint16 of the slab"""
        if self._edge_azimuth is None or not azimuth.shape[1]:
            return KnownColumns.none()
        gap = (int(azimuth[0, 0]) - self._edge_azimuth) % AZIMUTH_TURN
        return self._edge if gap <= WIDEST_GAP else KnownColumns.none()
