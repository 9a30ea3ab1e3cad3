"""Where the points of a cloud are shown: the rows of its sensor, the highest first, and columns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from lidarcodec.sensors.clouds.grid import MAX_CELLS, Grid, Numbers, grid_of
from lidarcodec.sensors.clouds.message import MAX_POINTS, CloudMessage
from lidarcodec.units import MAX_COLUMNS

_LOOKED_AT: Final = 8192
COLUMNS: Final = 2048
"""Columns of a turn, for points that are in no order."""


@dataclass(frozen=True, eq=False)
class View:
    """row, column: (N,) of each point; shown: whether it has a cell in the image of `rows` rows."""

    rows: int
    columns: int
    row: Numbers
    column: Numbers
    shown: npt.NDArray[np.bool_]

    def image(self, values: npt.NDArray[Any], dtype: npt.DTypeLike) -> npt.NDArray[Any]:
        """(rows, columns) of a value a point, 0 elsewhere."""
        found = np.zeros((self.rows, self.columns), dtype)
        found[self.row[self.shown], self.column[self.shown]] = values[self.shown]
        return found


def view_of(message: CloudMessage, rows: int, find: Callable[[CloudMessage], Grid | None] = grid_of) -> View | None:
    """The view of a message; None for one without x, y and z, or of more than two million points.

    rows: of the sensor; points beyond them are not shown. find: gives the grid of the message
    """
    if not 0 < message.head.points <= MAX_POINTS or message.xyz is None:
        return None
    grid = find(message)
    if grid is None:
        return _by_angles(message, rows)
    row = grid.row
    if _rises(message, grid):
        row = grid.rows - 1 - row
    return View(rows, grid.columns, row, grid.column, row < rows)


def _elevation(message: CloudMessage) -> npt.NDArray[np.float64]:
    assert message.xyz is not None
    x, y, z = np.where(message.returns, message.xyz, 0.0)
    found: npt.NDArray[np.float64] = np.arctan2(z, np.hypot(x, y))
    return found


def _rises(message: CloudMessage, grid: Grid) -> bool:
    """Whether higher rows of a grid look higher, by some of the points."""
    returned = np.flatnonzero(message.returns)
    if len(returned) < 2:
        return False
    some = returned[:: max(1, len(returned) // _LOOKED_AT)]
    x, y, z = (np.asarray(message.values(name))[some].astype(np.float64) for name in "xyz")
    elevation = np.arctan2(z, np.hypot(x, y))
    row = grid.row[some].astype(np.float64)
    return float(((row - row.mean()) * (elevation - elevation.mean())).sum()) > 0


def _by_angles(message: CloudMessage, rows: int) -> View:
    """Points by elevation and azimuth; points of one cell beside each other."""
    assert message.xyz is not None
    elevation = _elevation(message)
    seen = elevation[message.returns]
    top, bottom = (float(seen.max()), float(seen.min())) if len(seen) else (0.0, 0.0)
    row = np.clip(((top - elevation) / max(top - bottom, 1e-6) * rows).astype(np.int64), 0, rows - 1)
    x, y, _ = np.where(message.returns, message.xyz, 0.0)
    bins = np.floor((np.arctan2(-y, x) / (2 * np.pi) % 1.0) * COLUMNS).astype(np.int64)
    order = np.lexsort((bins, row))
    place = np.arange(len(row)) - np.searchsorted(row[order], row[order])
    apart = row[order] * 10**8
    column = np.empty(len(row), np.int64)
    column[order] = np.maximum.accumulate(bins[order] - place + apart) - apart + place
    columns = min(int(column.max()) + 1, MAX_COLUMNS, MAX_CELLS // rows)
    return View(rows, columns, row, column, column < columns)
