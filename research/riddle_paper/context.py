"""What the network sees of a return: the 99 cells before it in a patch of 10 x 10, and points of the scan before.

The patch holds the cell in its lower right corner: nine rows above, nine columns to the left, and what is before it in
its own row. Every neighbour is a point: its direction as seen from the cell's beam, its range, whether it is there, and
the time. Ranges enter as they were decoded. As the range of the cell is what is asked for, neighbours are measured
from the last valid one before it (`previous_valid`).

Neighbours stand in the order of their distance from the cell, so that of several equally good anchors the nearest is
taken: number 0 is the one to the left.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.units import RANGE_STEP_M
from research.riddle_paper.images import Cells, Mask, PaperImage, previous_valid
from research.riddle_paper.moved import MovedPoints

PATCH: Final = 10
"""Rows and columns of a patch."""
SPATIAL: Final = PATCH * PATCH - 1
FEATURES: Final = 7
"""Of a neighbour: azimuth, elevation, range coarse and fine, absolute range, whether it is valid, time."""
_AZIMUTH_UNIT_RAD, _ELEVATION_UNIT_RAD = 0.003, 0.006
"""About a column and a row of an HDL-64E."""
_COARSE_UNIT_M, _FINE_UNIT_M, _FAR_M = 0.02, 0.1, 40.0

Floats = npt.NDArray[np.float32]
Indices = npt.NDArray[np.intp]


def _offsets() -> npt.NDArray[np.intp]:
    places = [(-up, -left) for up in range(PATCH) for left in range(PATCH) if (up, left) != (0, 0)]
    # A row is about as far as two columns. Equally far: first those of the own row, then from the left.
    return np.array(sorted(places, key=lambda p: (4 * p[0] ** 2 + p[1] ** 2, -p[0], p[1])), np.intp)


OFFSETS: Final = _offsets()
"""(99, 2), row and column of each neighbour as seen from the cell."""


@dataclass(frozen=True, eq=False)
class Contexts:
    """What is known of N cells. K = 99 neighbours, and those of the scan before.

    features: (N, K, FEATURES) float32; valid: (N, K) bool
    anchors_m: (N, K) float32, range of each neighbour, metres; before_m: (N,) float32, of the last valid cell
    """

    features: Floats
    valid: Mask
    anchors_m: Floats
    before_m: Floats

    def widened(self, neighbours: int) -> Contexts:
        """The same with `neighbours` neighbours, those that are added not valid."""
        more = neighbours - self.valid.shape[1]
        if more <= 0:
            return self
        wide = ((0, 0), (0, more))
        features = np.pad(self.features, (*wide, (0, 0)))
        features[:, -more:, 6] = 1.0
        return Contexts(features, np.pad(self.valid, wide), np.pad(self.anchors_m, wide), self.before_m)


class ContextReader:
    """Gives the contexts of an image's cells. A decoder lets it see each range as soon as it has it.

    image: its cells are looked at only through `see`, unless `complete`
    earlier: points of the scan before, moved to where they are now; None for the intra variant
    """

    def __init__(self, image: PaperImage, earlier: MovedPoints | None = None, *, complete: bool = True) -> None:
        self._step_m, self._earlier = image.step_m, earlier
        edge = ((PATCH - 1, 0), (PATCH - 1, 0))
        self._cells = np.pad(image.cells if complete else np.zeros_like(image.cells), edge)
        self._valid = np.pad(image.valid, edge)
        self._azimuth, self._elevation = np.pad(image.azimuth, edge), np.pad(image.elevation, edge)
        self._before = previous_valid(image.cells, image.valid) if complete else np.zeros_like(image.cells)
        self._in_row = np.zeros(image.cells.shape, np.bool_)  # whether a valid cell is to the left
        self._in_row[:, 1:] = np.logical_or.accumulate(image.valid, axis=1)[:, :-1]

    def before(self, rows: Indices, columns: Indices) -> Cells:
        """(N,) int32, the last valid cell before each."""
        cells: Cells = self._before[rows, columns]
        return cells

    def arrive(self, rows: Indices, columns: Indices) -> None:
        """What a decoder does at each cell of a front before it predicts: finds the last valid one before it."""
        r, c = rows + (PATCH - 1), columns + (PATCH - 1)
        left = np.where(self._valid[r, c - 1], self._cells[r, c - 1], self._before[rows, columns - 1])
        up = np.where(self._valid[r - 1, c], self._cells[r - 1, c], self._before[rows - 1, columns])
        up = np.where(rows > 0, up, 0)
        self._before[rows, columns] = np.where(self._in_row[rows, columns], left, up)

    def see(self, rows: Indices, columns: Indices, cells: Cells) -> None:
        """Takes ranges that are now known."""
        self._cells[rows + (PATCH - 1), columns + (PATCH - 1)] = cells

    def read(self, rows: Indices, columns: Indices) -> Contexts:
        """Contexts of the cells at (rows, columns), (N,) each."""
        r = rows[:, None] + (OFFSETS[:, 0] + PATCH - 1)
        c = columns[:, None] + (OFFSETS[:, 1] + PATCH - 1)
        valid = self._valid[r, c]
        ranges = self._cells[r, c].astype(np.float32) * np.float32(self._step_m)
        here = (rows + (PATCH - 1), columns + (PATCH - 1))
        azimuth, elevation = self._azimuth[here], self._elevation[here]
        before = self.before(rows, columns).astype(np.float32) * np.float32(self._step_m)
        features = _features(
            self._azimuth[r, c] - azimuth[:, None],
            self._elevation[r, c] - elevation[:, None],
            ranges,
            before,
            valid,
            0.0,
        )
        if self._earlier is None:
            return Contexts(features, valid, ranges, before)
        seen = self._earlier.nearest(rows, azimuth, before)
        moved = _features(seen.azimuth, seen.elevation, seen.ranges_m, before, seen.valid, 1.0)
        return Contexts(
            np.concatenate([features, moved], axis=1),
            np.concatenate([valid, seen.valid], axis=1),
            np.concatenate([ranges, seen.ranges_m], axis=1),
            before,
        )


def _features(azimuth: Floats, elevation: Floats, ranges: Floats, before: Floats, valid: Mask, time: float) -> Floats:
    """(N, K, FEATURES) float32 of directions as seen from the cell's beam, and ranges in metres."""
    apart = ranges - before[:, None]
    features = np.empty((*valid.shape, FEATURES), np.float32)
    features[..., 0] = azimuth / np.float32(_AZIMUTH_UNIT_RAD)
    features[..., 1] = elevation / np.float32(_ELEVATION_UNIT_RAD)
    features[..., 2] = np.sign(apart) * np.log2(1 + np.abs(apart) / np.float32(_COARSE_UNIT_M)) / 4
    features[..., 3] = np.clip(apart / np.float32(_FINE_UNIT_M), -1, 1)
    features[..., 4] = ranges / np.float32(_FAR_M)
    features[..., :5] *= valid[..., None]
    features[..., 5] = valid
    features[..., 6] = time
    return features


def step_feature(step: int) -> float:
    """How coarse an image is, for the network: 0 at 2 mm, 1 at 51 cm."""
    return float(np.log2(step) / 8)


def nearest_anchor(contexts: Contexts, ranges_m: Floats) -> tuple[Indices, Mask]:
    """(N,) number of the valid neighbour whose range is nearest to the cell's, and (N,) whether there is any."""
    apart = np.where(contexts.valid, np.abs(contexts.anchors_m - ranges_m[:, None]), np.float32(np.inf))
    apart = np.rint(apart / np.float32(RANGE_STEP_M))  # float noise is no distance
    any_valid = np.logical_or.reduce(contexts.valid, axis=1)
    return apart.argmin(axis=1), any_valid
