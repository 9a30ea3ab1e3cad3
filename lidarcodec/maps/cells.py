"""CellGrid: points of many scans as means of cells, tile by tile, with counts of who saw what.

Of each cell it keeps how many scans hit it, how many saw through it, and the first and the last place of the path from
which it was hit. A scan sees through a cell if its returns around that direction all lie clearly behind the cell. What
moves is hit for a moment and seen through before and after, so cells that are seen through more often than they are
hit are left out.

Tiles that the sensor has left are kept in a folder. Memory is bounded by the tiles within 150 m of the sensor. `state`
and `go_on` carry a grid over the end of a program.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec.budgets import largest
from lidarcodec.errors import SourceError
from lidarcodec.evaluation.rigid import Matrix
from lidarcodec.evaluation.trajectory import voxel_means
from lidarcodec.untrusted.npz import ArraysRefusedError, read_npz

MOST_ARRAYS: Final = largest("arrays") or 0
NEAR_M: Final = 150.0
"""Tiles whose middle is farther away are put into the folder."""
GATHER_EVERY: Final = 8
THROUGH_M: Final = 40.0
"""Only nearer cells are checked for being seen through: beams are too far apart beyond."""
_COLUMNS, _ROWS = 900, 128
_TOP, _BOTTOM = 0.5, -0.6
"""Radians of elevation that the images of ranges cover."""
_HALF: Final = 1 << 20
Ints = npt.NDArray[np.int64]


class Cells(NamedTuple):
    """Cells of a tile. keys: (N,) int64, increasing; sums: (N, 3) of the scans' means, metres; hits, through: (N,)
    numbers of scans; first, last: (N,) places of the path"""

    keys: Ints
    sums: Matrix
    hits: Ints
    through: Ints
    first: Ints
    last: Ints

    def means(self) -> Matrix:
        """(N, 3) metres."""
        found: Matrix = self.sums / self.hits[:, None]
        return found

    def taken(self, chosen: npt.NDArray[np.bool_]) -> Cells:
        """Some of the cells."""
        return Cells(*[part[chosen] for part in self])  # type: ignore[arg-type]


EMPTY: Final = Cells(np.empty(0, np.int64), np.empty((0, 3)), *[np.empty(0, np.int64)] * 4)


class GridState(NamedTuple):
    """far: file of each tile that is in the folder;  scans: how many were added
    near: the parts of all other tiles. Of each part: x and y of its `tiles`, and `sizes`; and the columns of all cells
    """

    far: dict[tuple[int, int], str]
    scans: int
    near: dict[str, npt.NDArray[Any]]


def joined(parts: list[Cells]) -> Cells:
    """The cells of several parts as one, with sums and counts added up."""
    together = Cells(*[np.concatenate(columns) for columns in zip(*parts, strict=True)])
    keys, at = np.unique(together.keys, return_inverse=True)
    first, last = np.full(len(keys), np.iinfo(np.int64).max), np.zeros(len(keys), np.int64)
    np.minimum.at(first, at, together.first)
    np.maximum.at(last, at, together.last)
    sums: Matrix = np.stack(
        [np.bincount(at, together.sums[:, axis], len(keys)).astype(np.float64) for axis in range(3)], axis=1
    )
    hits, through = (np.bincount(at, part, len(keys)).astype(np.int64) for part in (together.hits, together.through))
    return Cells(keys, sums, hits, through, first, last)


class CellGrid:
    """Cells of all tiles. cell_m: their width; tile_m: width of tiles; folder: for tiles that are far away"""

    def __init__(self, cell_m: float, tile_m: float, folder: Path) -> None:
        self._cell_m, self._tile_m, self._folder = cell_m, tile_m, folder
        self._near: dict[tuple[int, int], list[Cells]] = {}
        self._far: dict[tuple[int, int], str] = {}
        self._held: frozenset[str] = frozenset()
        self._scans = self._files = 0

    def add(self, points: Matrix, sensor: Matrix, place: int, *, look_through: bool) -> None:
        """Add the points (N, 3) of a scan in the world. sensor: (3,) its position; place: number of the place of the
        path; look_through: whether to count the cells that the scan sees through.

        Raises SourceError if the points are more than 200 km from the origin in height, or beyond all maps.
        """
        if look_through:
            self._look_through(points, sensor)
        # near the origin, because coordinates of UTM are too large for the grid; by whole tiles, so that cells stay
        near = np.floor(sensor / self._tile_m) * self._tile_m
        means = voxel_means(points - near, self._cell_m) + near
        tiles = np.floor(means[:, :2] / self._tile_m).astype(np.int64)
        keys = self._keys(means)
        order = np.lexsort((tiles[:, 0], tiles[:, 1]))
        ends = np.flatnonzero((np.diff(tiles[order], axis=0) != 0).any(axis=1)) + 1
        for chosen in np.split(order, ends) if len(order) else ():
            x, y = tiles[chosen[0]].tolist()
            count = len(chosen)
            one, none = np.ones(count, np.int64), np.zeros(count, np.int64)
            at = np.full(count, place)
            self._near.setdefault((x, y), []).append(Cells(keys[chosen], means[chosen], one, none, at, at))
        self._scans += 1
        if self._scans % GATHER_EVERY == 0:
            self._gather(sensor)

    def tiles(self) -> list[tuple[int, int]]:
        """All tiles with cells, ordered by (y, x)."""
        return sorted({*self._near, *self._far}, key=lambda tile: tile[::-1])

    def cells(self, tile: tuple[int, int]) -> Cells:
        """The cells of a tile."""
        parts = list(self._near.get(tile, []))
        if tile in self._far:
            parts.append(self._load(tile))
        return joined(parts) if parts else EMPTY

    def state(self) -> GridState:
        """All that there is. Its files stay as they are, until the next call and `let_go`."""
        parts = [(tile, part) for tile, parts in self._near.items() for part in parts]
        tiles = np.array([tile for tile, _ in parts], np.int64).reshape(-1, 2)
        sizes = np.array([len(part.keys) for _, part in parts], np.int64)
        columns = zip(*(part for _, part in parts), strict=True) if parts else ([one] for one in EMPTY)
        near = dict(zip(Cells._fields, map(np.concatenate, columns), strict=True))
        self._held |= frozenset(self._far.values())
        return GridState(dict(self._far), self._scans, {"tiles": tiles, "sizes": sizes, **near})

    def let_go(self) -> None:
        """The newest `state` is safe: remove files that only earlier ones had."""
        now = frozenset(self._far.values())
        for name in self._held - now:
            (self._folder / name).unlink(missing_ok=True)
        self._held = now

    def go_on(self, state: GridState) -> None:
        """Go on from a state, in an empty grid with the same folder."""
        self._far, self._scans = dict(state.far), state.scans
        self._held = frozenset(self._far.values())
        self._files = 1 + max((int(name.split("-")[-1].removesuffix(".npz")) for name in self._held), default=-1)
        columns = [np.split(state.near[name], np.cumsum(state.near["sizes"]))[:-1] for name in Cells._fields]
        for (x, y), *part in zip(state.near["tiles"].tolist(), *columns, strict=True):
            self._near.setdefault((x, y), []).append(Cells(*part))

    def finish(self) -> Iterator[tuple[tuple[int, int], Cells]]:
        """All tiles with their cells, ordered by (y, x), one in memory at a time."""
        for tile in list(self._near):
            self._put_away(tile)
        for tile in self.tiles():
            yield tile, self._load(tile)

    def _keys(self, points: Matrix) -> Ints:
        cells = np.floor(points / self._cell_m).astype(np.int64)
        wide = round(self._tile_m / self._cell_m)
        cells[:, :2] %= wide
        if len(cells) and not -_HALF <= cells[:, 2].min() <= cells[:, 2].max() < _HALF:
            raise SourceError("the points of the map are spread over more than 200 km in height: check the poses")
        keys: Ints = ((cells[:, 2] + _HALF) * wide + cells[:, 1]) * wide + cells[:, 0]
        return keys

    def _gather(self, sensor: Matrix) -> None:
        for tile, parts in list(self._near.items()):
            if len(parts) > 1:
                self._near[tile] = [joined(parts)]
            middle = (np.array(tile) + 0.5) * self._tile_m
            if np.linalg.norm(middle - sensor[:2]) > NEAR_M:
                self._put_away(tile)

    def _put_away(self, tile: tuple[int, int]) -> None:
        cells, before = self.cells(tile), self._far.get(tile)
        del self._near[tile]
        self._far[tile] = name = f"{tile[0]}_{tile[1]}-{self._files}.npz"
        self._files += 1
        np.savez(self._folder / name, **cells._asdict())
        if before is not None and before not in self._held:
            (self._folder / before).unlink()

    def _load(self, tile: tuple[int, int]) -> Cells:
        path = self._folder / self._far[tile]
        try:
            found = read_npz(path, Cells._fields, most_bytes=MOST_ARRAYS)
            return Cells(*(found[name] for name in Cells._fields))
        except (OSError, ArraysRefusedError, KeyError) as error:
            raise SourceError(f"{path} cannot be read ({error}): delete {path.parent}, and begin anew") from None

    def _look_through(self, points: Matrix, sensor: Matrix) -> None:
        """Count the cells near the sensor that lie clearly in front of all returns around their direction."""
        image = _nearest_ranges(points - sensor)
        for tile, parts in self._near.items():
            middle = (np.array(tile) + 0.5) * self._tile_m
            if not parts or np.linalg.norm(middle - sensor[:2]) > THROUGH_M + self._tile_m:
                continue
            cells = parts[0]
            off = cells.means() - sensor
            distance = np.linalg.norm(off, axis=1)
            row, column, inside = _directions(off, distance)
            behind = image[row, column] > distance + np.maximum(0.5, 0.03 * distance)
            seen = inside & behind & (distance < THROUGH_M)
            parts[0] = cells._replace(through=cells.through + seen)


def _directions(off: Matrix, distance: Matrix) -> tuple[Ints, Ints, npt.NDArray[np.bool_]]:
    """Row and column of an image of ranges for points relative to the sensor, and whether they lie in it."""
    turn = np.arctan2(off[:, 1], off[:, 0]) / (2 * np.pi) + 0.5
    up = np.arcsin(np.clip(off[:, 2] / np.maximum(distance, 1e-9), -1, 1))
    row = np.floor((_TOP - up) / (_TOP - _BOTTOM) * _ROWS).astype(np.int64)
    column = (turn * _COLUMNS).astype(np.int64) % _COLUMNS
    inside = (row >= 0) & (row < _ROWS)
    return np.clip(row, 0, _ROWS - 1), column, inside


def _nearest_ranges(off: Matrix) -> Matrix:
    """(rows, columns) the nearest return in each direction and those around it; 0 if there is none."""
    distance = np.linalg.norm(off, axis=1)
    row, column, inside = _directions(off, distance)
    image = np.full((_ROWS, _COLUMNS), np.inf)
    np.minimum.at(image, (row[inside], column[inside]), distance[inside])
    sides = np.minimum(np.minimum(np.roll(image, 1, axis=1), np.roll(image, -1, axis=1)), image)
    padded = np.pad(sides, ((1, 1), (0, 0)), constant_values=np.inf)
    around = np.minimum(np.minimum(padded[:-2], padded[2:]), sides)
    return np.where(np.isinf(around), 0.0, around)
