"""The canvas of video: a whole turn, on which the same direction is the same column in every frame.

Video predicts a picture from the one before it, so each direction must keep its column, whether frames are whole
turns, 348 packets or slabs. The turn has `columns` columns, a few more than firings, so that it also holds a turn that
was slower. A firing lies where its azimuth says, or right of the one before if that is there already. Rows move by
their rotation correction, as on the canvas of still images, but round the turn: there are no corners.

Frames longer than a turn take several `bands` of 64 rows. Frames whose azimuths are no rotation (the sensor stands, or
it is noise) are not `anchored`: their columns lie in their order.

>>> azimuth = np.arange(35900, 35990, 18, np.uint16).repeat(2).reshape(-1, 2).T
>>> layout = TurnLayout.fitting(azimuth, np.ones((2, 5), np.bool_))
>>> layout
TurnLayout(columns=2016, bands=1, anchored=True, rows=64)
>>> positions(layout, azimuth, np.ones((2, 5), np.bool_))[0].tolist()
[2010, 2011, 2012, 2013, 2014]
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import SectionError
from lidarcodec.sensor_model import CALIBRATION_FIELDS, SensorModel
from lidarcodec.units import AZIMUTH_TURN, LASERS, LASERS_PER_BLOCK, TABLE_TURN

Mask = npt.NDArray[np.bool_]
Places = npt.NDArray[np.int64]

MACROBLOCK: Final = 16
"""Sides of a picture are multiples of it: nothing is padded or cropped."""
MAX_WIDTH: Final = 8192
MAX_BANDS: Final = 16
MAX_PLACES: Final = 32768
"""Columns of all bands together, at most: more than the widest frame has. It limits the memory of a decoder."""
_FEWEST: Final = 64
"""Fewer columns are not a turn."""
_SPARE: Final = 128
"""One column in so many is added: KITTI's turns have 2144 to 2166 firings."""
_ROTATION: Final = list(CALIBRATION_FIELDS).index("rot_correction_rad")


def _whole(count: int) -> int:
    return -(-count // MACROBLOCK) * MACROBLOCK


@dataclass(frozen=True)
class TurnLayout:
    """columns: of a band, a multiple of 16; bands: one below the other; anchored: whether azimuths place columns

    rows: of the sensor; those of a band are the next multiple of 16
    """

    columns: int
    bands: int
    anchored: bool
    rows: int = LASERS

    def __post_init__(self) -> None:
        whole = self.columns > 0 and self.columns % MACROBLOCK == 0 and self.columns <= MAX_WIDTH
        if not whole or not 0 < self.bands <= MAX_BANDS or self.places > MAX_PLACES:
            raise SectionError(f"a video of {self.bands} bands of {self.columns} columns")

    @property
    def places(self) -> int:
        """Columns of all bands."""
        return self.columns * self.bands

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the picture."""
        return _whole(self.rows) * self.bands, self.columns

    @classmethod
    def fitting(cls, azimuth: npt.NDArray[np.uint16], fired: Mask, rows: int = LASERS) -> TurnLayout:
        """The layout for a stream that begins with this frame. azimuth: (2, W), 0.01 degree; fired: (2, W) bool."""
        turn = max(_turn_of(azimuth[half][fired[half]]) for half in range(2))
        columns = _whole(turn + turn // _SPARE + 1)
        if turn >= _FEWEST and columns <= MAX_WIDTH:
            longest = max(_length(columns, azimuth[half][fired[half]]) for half in range(2))
            bands = -(-longest // columns)
            if bands <= MAX_BANDS and columns * bands <= MAX_PLACES:
                return cls(columns, bands, anchored=True, rows=rows)
        width = max(azimuth.shape[1], 1)
        bands = -(-width // MAX_WIDTH)
        return cls(_whole(-(-width // bands)), bands, anchored=False, rows=rows)

    def holds(self, azimuth: npt.NDArray[np.uint16], fired: Mask) -> bool:
        """Whether a frame has room. azimuth: (2, W), 0.01 degree; fired: (2, W) bool."""
        if not self.anchored:
            return int(azimuth.shape[1]) <= self.places
        return all(_length(self.columns, azimuth[half][fired[half]]) <= self.places for half in range(2))


def _turn_of(azimuth: npt.NDArray[np.uint16]) -> int:
    """Columns in a turn, rounded up; 0 if nothing turned."""
    angles = azimuth.astype(np.int64)
    travel = int(((angles[1:] - angles[:-1]) % AZIMUTH_TURN).sum())
    return -(-AZIMUTH_TURN * (len(azimuth) - 1) // travel) if travel > 0 else 0


def _run(columns: int, azimuth: npt.NDArray[np.uint16]) -> Places:
    """(N,) int64, rising: where firings lie on a turn that is rolled out. azimuth: (N,)."""
    angles = azimuth.astype(np.int64)
    angles[1:] = angles[0] + np.cumsum((angles[1:] - angles[:-1]) % AZIMUTH_TURN)
    order = np.arange(len(angles))
    run: Places = np.maximum.accumulate(angles * columns // AZIMUTH_TURN - order) + order
    return run


def _length(columns: int, azimuth: npt.NDArray[np.uint16]) -> int:
    """Places from the first firing to the last."""
    if not len(azimuth):
        return 1
    run = _run(columns, azimuth)
    return int(run[-1] - run[0]) + 1


def positions(layout: TurnLayout, azimuth: npt.NDArray[np.uint16], fired: Mask) -> Places:
    """(2, W) int64, place of each column's upper and lower half, 0..places - 1; of a half no two are the same.

    Halves that were not fired have none: what stands there means nothing. Raises SectionError if there is no room.
    """
    if not layout.holds(azimuth, fired):
        raise SectionError(f"a frame of {azimuth.shape[1]} columns on {layout.places} places")
    places = np.tile(np.arange(azimuth.shape[1], dtype=np.int64), (2, 1))
    if layout.anchored:
        for half in range(2):
            angles = azimuth[half][fired[half]]
            if len(angles):
                places[half][fired[half]] = _run(layout.columns, angles) % layout.places
    return places


def cells(layout: TurnLayout, places: Places, sensor: SensorModel, valid: Mask) -> npt.NDArray[np.intp]:
    """(N,) intp, index in the flattened picture of each of the N returns, in row order.

    places: (2, W), of `positions`; valid: (64, W) bool.
    """
    half = (sensor.laser_of_ring >= LASERS_PER_BLOCK).astype(np.intp)
    shift = np.zeros(LASERS, np.int32)
    if layout.anchored:
        rotation = sensor.calibration.table[_ROTATION][sensor.laser_of_ring].astype(np.int64)
        angle = (rotation[0] - rotation + TABLE_TURN // 2) % TABLE_TURN - TABLE_TURN // 2
        shift = ((2 * angle * layout.columns + TABLE_TURN) // (2 * TABLE_TURN) % layout.places).astype(np.int32)
    place = places.astype(np.int32)[half] + shift[:, None]
    np.subtract(place, layout.places, out=place, where=place >= layout.places)
    if layout.bands > 1:
        band, column = np.divmod(place, layout.columns)
        place = band * (LASERS * layout.columns) + column
    place += (np.arange(LASERS, dtype=np.int32) * layout.columns)[:, None]
    return place[valid].astype(np.intp, copy=False)


def aligned_cells(
    layout: TurnLayout, places: Places, shift: npt.NDArray[np.int32], known: Mask
) -> npt.NDArray[np.intp]:
    """The same for a sensor whose columns have one azimuth. places: (W,); shift: (H,), columns a row moves by."""
    rows = len(shift)
    place = places + shift.astype(np.int64)[:, None] * layout.anchored
    band, column = np.divmod(place % layout.places, layout.columns)
    cell = (band * (layout.shape[0] // layout.bands) + np.arange(rows)[:, None]) * layout.columns + column
    found: npt.NDArray[np.intp] = cell[known].astype(np.intp, copy=False)
    return found
