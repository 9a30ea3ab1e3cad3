"""Sectors of a turn: the columns whose upper block looks into one of twelve parts of the circle.

>>> columns_of(np.array([[2999, 3000, 35999, 0]] * 2, np.uint16), 0).tolist()
[0, 3]
>>> nearest_ahead(np.array([[2999, 3000, 35999, 18000]] * 2, np.uint16))
[0, 11, 1, 6]
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.frame import Frame
from lidarcodec.units import AZIMUTH_TURN

SECTORS: Final = 12
"""Sectors in a turn. Sector 0 begins at azimuth 0, straight ahead, and azimuths increase to the right."""
_WIDTH: Final = AZIMUTH_TURN // SECTORS


def sector_of(azimuth: npt.NDArray[np.uint16]) -> npt.NDArray[np.uint16]:
    """(W,) the sector of each column. azimuth: (2, W), of upper and lower blocks"""
    sectors: npt.NDArray[np.uint16] = azimuth[0] // np.uint16(_WIDTH)
    return sectors


def columns_of(azimuth: npt.NDArray[np.uint16], sector: int) -> npt.NDArray[np.intp]:
    """(n,) the columns of a sector, ascending. azimuth: (2, W)"""
    return np.flatnonzero(sector_of(azimuth) == sector)


def nearest_ahead(azimuth: npt.NDArray[np.uint16]) -> list[int]:
    """The sectors that have columns, those that look ahead first and those that look back last. azimuth: (2, W)"""
    present: list[int] = np.unique(sector_of(azimuth)).tolist()
    return sorted(present, key=lambda sector: (min(sector, SECTORS - 1 - sector), sector))


def part_of(frame: Frame, columns: npt.NDArray[np.intp]) -> Frame:
    """A frame of some columns, without packets. columns: (n,), ascending"""
    return Frame(
        index=frame.index,
        stamp_ns=frame.stamp_ns,
        range=np.ascontiguousarray(frame.range_u16[:, columns]),
        intensity=np.ascontiguousarray(frame.intensity[:, columns]),
        azimuth=np.ascontiguousarray(frame.azimuth[:, columns]),
        fired=np.ascontiguousarray(frame.fired[:, columns]),
        sensor=frame.sensor,
    )
