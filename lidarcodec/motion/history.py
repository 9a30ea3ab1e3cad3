"""What was sent since the last key frame, looked up by azimuth, so that frames may be turns, slabs, or of any width.

Encoder and decoder each keep one and update it in the same way. Masks refer to `MaskHistory`: a table of 2000
directions with what was last sent there, for each row. A direction is 0.18 degree, a little more than an HDL-64E turns
between two firings. Rows of each block are looked up by the azimuth of that block. Ranges refer to `StreamHistory`.
"""

from __future__ import annotations

from collections import deque
from typing import Final, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from lidarcodec.entropy import KnownColumns
from lidarcodec.errors import SectionError
from lidarcodec.motion.motion import Motion
from lidarcodec.motion.warp import RangeHistory, swept
from lidarcodec.sensor_model import SensorModel
from lidarcodec.units import AZIMUTH_TURN, LASERS, LASERS_PER_BLOCK

DIRECTION_STEP: Final = 18
"""Azimuth steps of 0.01 degree in a direction."""
DIRECTIONS: Final = AZIMUTH_TURN // DIRECTION_STEP
EDGE_COLUMNS: Final = 128
"""Columns before a slab that its coder may use: more than the rows of an HDL-64E are shifted against each other."""
WIDEST_GAP: Final = 500
"""Azimuth steps that may be missing before a slab, if its coder is to use the columns before it."""
WAITING_SWEEP: Final = 3600
WAITING_COLUMNS: Final = 1024
"""Azimuth steps, or columns, that must have been sent after a slab before the history stores it."""

Mask = npt.NDArray[np.bool_]
Ranges = npt.NDArray[np.uint16]


class MaskHistory:
    """The masks last sent in each direction."""

    def __init__(self) -> None:
        self._sent: Mask = np.zeros((DIRECTIONS, LASERS), np.bool_)  # (directions, rows)

    def before(self, azimuth: npt.NDArray[np.uint16], sensor: SensorModel) -> Mask:
        """(64, W) bool, the mask last sent in the direction of each cell. azimuth: (2, W) uint16, below 36000."""
        if not self._sent.any():  # quick for a covered sensor, and for hostile messages without returns
            return np.zeros((LASERS, azimuth.shape[1]), np.bool_)
        seen = np.empty((LASERS, azimuth.shape[1]), np.bool_)
        for rows, directions in self._halves(azimuth, sensor):
            seen[rows] = self._sent[directions][:, rows].T
        return seen

    def remember(self, valid: Mask, azimuth: npt.NDArray[np.uint16], sensor: SensorModel) -> None:
        """Stores a mask that was sent, (64, W) bool. Of several columns in one direction the last one stays."""
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
    """Rows as a slice if they are adjacent, as those of a block mostly are: indexing is then four times as fast."""
    return slice(int(rows[0]), int(rows[-1]) + 1) if rows[-1] - rows[0] + 1 == len(rows) else rows


class Memory(Protocol):
    """The adaptive state of a coder of ranges."""

    def reset(self) -> None:
        """Returns to the initial state, before a key frame."""


class _Sent(NamedTuple):
    ranges: Ranges
    azimuth: Ranges
    fired: Mask
    sensor: SensorModel
    swept: int | None  # azimuth steps of a slab; None: a whole frame


class StreamHistory:
    """What ranges refer to: the state of their coder, the ranges of the last turn, and the columns before a slab.

    memory: the state of the codec's coder; it is reset here
    """

    def __init__(self, memory: Memory) -> None:
        self._memory = memory
        self._seen = RangeHistory()
        self._edge = KnownColumns.none()  # the last columns, up to EDGE_COLUMNS, if slabs were sent last
        self._edge_azimuth: int | None = None
        self._waiting: deque[_Sent] = deque()

    def forget(self) -> None:
        """Forgets everything, before a key message."""
        self._memory.reset()
        self._seen.forget()
        self._waiting.clear()
        self.forget_edge()

    @property
    def seen(self) -> RangeHistory:
        """The ranges of the last turn."""
        self._take_waiting()
        return self._seen

    def expected(self, motion: Motion, azimuth: Ranges, fired: Mask, sensor: SensorModel) -> Ranges:
        """(64, W) uint16, the expected ranges of a frame after a motion: `RangeHistory.expected`."""
        return self.seen.expected(motion, azimuth, fired, sensor)

    def remember(self, ranges: Ranges, azimuth: Ranges, fired: Mask, sensor: SensorModel, *, slab: bool) -> None:
        """Stores a frame that was sent, (64, W) uint16 as it is decoded, 0 outside of its returns.

        A slab waits until enough was sent after it. The history to the left of the next slab is then a turn old, as all
        of it is, and not a moment old. A whole frame waits until the history is next used, so that a stream of key
        frames spends no time on it.
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
        """Stores the columns of a slab, as they are decoded, with their expected ranges."""
        foreseen = np.zeros_like(ranges) if expected is None else expected
        self._edge = self._edge.and_then(KnownColumns(ranges, fired, foreseen)).last(EDGE_COLUMNS)
        self._edge_azimuth = int(azimuth[0, -1])

    def forget_edge(self) -> None:
        """Forgets the columns of slabs, after a whole frame."""
        self._edge, self._edge_azimuth = KnownColumns.none(), None

    def edge_before(self, azimuth: Ranges) -> KnownColumns:
        """The columns to use before a slab, none if too many are missing. azimuth: (2, W) uint16, of the slab."""
        if self._edge_azimuth is None or not azimuth.shape[1]:
            return KnownColumns.none()
        gap = (int(azimuth[0, 0]) - self._edge_azimuth) % AZIMUTH_TURN
        return self._edge if gap <= WIDEST_GAP else KnownColumns.none()

    def edge_of(self, columns: int) -> KnownColumns:
        """The last so many columns, which a slab that was received refers to.

        Raises SectionError if there are fewer.
        """
        edge = self._edge.last(columns)
        if edge.ranges.shape[1] != columns:
            raise SectionError(f"a slab refers to {columns} columns before it: {edge.ranges.shape[1]} are known")
        return edge
