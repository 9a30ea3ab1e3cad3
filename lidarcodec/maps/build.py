"""MapBuilder: scans with poses become a map.

scans -> deskewed points in the world -> cells with counts (cells.py) -> without what moves -> normals -> tiles
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import SourceError
from lidarcodec.evaluation.rigid import Matrix
from lidarcodec.maps.cells import EMPTY, CellGrid, Cells, GridState
from lidarcodec.maps.file import TILE_M, Head, MapWriter
from lidarcodec.maps.points import LOCAL, MOST_COUNT, NORMAL_BITS, MapFrame, packed_normals
from lidarcodec.maps.tiles import CELL_M, Tile, unlike

PLACE_M: Final = 1.0
"""Distance of places of the path."""
MOST_PLACES: Final = 1 << 16
BORDER_M: Final = 1.5
"""Points of other tiles within this distance are neighbours for normals."""
NEIGHBOURS: Final = 12
LEAST_SEEN: Final = 3
FEWEST: Final = 100
_KEPT_TILES: Final = 16


class MapBuilder:
    """Collects scans and writes a map. folder: an empty one, for tiles that are far from the sensor"""

    def __init__(self, folder: Path, step_um: int, frame: MapFrame = LOCAL, least_seen: int = LEAST_SEEN) -> None:
        self._grid = CellGrid(CELL_M, TILE_M, folder)
        self._step_um, self._frame, self._least_seen = step_um, frame, least_seen
        self.path: list[Matrix] = []
        self._before: Matrix | None = None
        self.length_m = 0.0
        self.scans = self.moving = self.seldom = 0

    def start_drive(self) -> None:
        """The next scan begins another drive: the way to it is not part of the path."""
        self._before = None

    def add(self, points: Matrix, pose: Matrix) -> None:
        """Add the points (N, 3) of a scan in the world, and the sensor's pose (4, 4). About 0.1 s.

        Raises SourceError if the path is longer than 65 km.
        """
        place = pose[:3, 3].copy()
        moved_m = np.inf if self._before is None or not self.path else float(np.linalg.norm(place - self.path[-1]))
        if self._before is not None:
            self.length_m += float(np.linalg.norm(place - self._before))
        self._before = place
        if moved_m >= PLACE_M:
            if len(self.path) == MOST_PLACES:
                raise SourceError("a map can hold at most 65 km of drives: build several maps")
            self.path.append(place)
        self._grid.add(points, place, len(self.path) - 1, look_through=moved_m >= PLACE_M)
        self.scans += 1

    def state(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """What `go_on` needs: values for a JSON file, and arrays. Files that it names stay until `let_go`."""
        grid = self._grid.state()
        values = {
            "far": [[*tile, name] for tile, name in grid.far.items()],
            "grid_scans": grid.scans,
            "before": None if self._before is None else self._before.tolist(),
            "length_m": self.length_m,
            "scans": self.scans,
        }
        return values, {"path": np.array(self.path).reshape(-1, 3), **grid.near}

    def let_go(self) -> None:
        """The newest `state` is safe: remove files that only earlier ones had."""
        self._grid.let_go()

    def go_on(self, values: dict[str, Any], arrays: dict[str, Any]) -> None:
        """Go on from a `state`, before the first scan."""
        near = {name: array for name, array in arrays.items() if name != "path"}
        self._grid.go_on(GridState({(x, y): name for x, y, name in values["far"]}, values["grid_scans"], near))
        self.path = list(arrays["path"])
        self._before = None if values["before"] is None else np.array(values["before"])
        self.length_m, self.scans = values["length_m"], values["scans"]

    def write(self, file: BinaryIO, tick: Callable[[], None] = lambda: None) -> int:
        """Write the map, and return the number of its points. More scans may be added later, for another file.

        tick: called after each tile
        Raises SourceError if there are fewer than 100 points.
        """
        bits = {"normal_a": NORMAL_BITS, "normal_b": NORMAL_BITS, "count": 8}
        seen_bits = max((len(self.path) - 1).bit_length(), 1)
        head = Head(self._step_um, {**bits, "first": seen_bits, "last": seen_bits}, self._frame)
        writer = MapWriter(file, head)
        static = _Static(self._grid, self._least_seen)
        written = self.moving = self.seldom = 0
        for tile, _ in self._grid.finish():
            cells = static.of(tile)
            self.moving += static.moving
            self.seldom += static.seldom
            if len(cells.keys):
                made = self._tile(tile, cells, static, head)
                writer.write(made)
                written += len(made.steps)
            tick()
        if written < FEWEST:
            raise SourceError(
                f"only {written} points were seen by at least {self._least_seen} scans, which is "
                "too few for a map: use more frames, or a smaller --least-seen"
            )
        writer.close(np.array(self.path), self.length_m)
        return written

    def _tile(self, tile: tuple[int, int], cells: Cells, static: _Static, head: Head) -> Tile:
        means = cells.means()
        normals = _normals(means, static.around(tile))
        corner = np.array([*(np.array(tile) * head.width), -(1 << 40)])
        last = corner + np.array([head.width - 1, head.width - 1, 1 << 41])
        steps = np.clip(
            np.rint(means / head.step_m).astype(np.int64), corner, last
        )  # a mean may round to the next tile
        chosen = unlike(steps)
        a, b = packed_normals(normals)
        counts = np.minimum(cells.hits, MOST_COUNT)
        columns = np.stack([a, b, counts, cells.first, cells.last], axis=1).astype(np.uint16)
        return Tile(*tile, steps[chosen], columns[chosen])


class _Static:
    """The cells of tiles without what moves, and without those that were seen too seldom. Some tiles are kept."""

    def __init__(self, grid: CellGrid, least_seen: int) -> None:
        self._grid, self._least_seen = grid, least_seen
        self._kept: OrderedDict[tuple[int, int], tuple[Cells, int, int]] = OrderedDict()
        self._all = set(grid.tiles())
        self.moving = self.seldom = 0

    def of(self, tile: tuple[int, int]) -> Cells:
        """The cells of a tile. `moving` and `seldom` are then the numbers of those that were left out."""
        if tile not in self._kept:
            cells = self._grid.cells(tile) if tile in self._all else EMPTY
            still = cells.through <= cells.hits
            often = cells.hits >= self._least_seen
            found = cells.taken(still & often)
            self._kept[tile] = found, int(np.count_nonzero(~still)), int(np.count_nonzero(still & ~often))
            while len(self._kept) > _KEPT_TILES:
                self._kept.popitem(last=False)
        cells, self.moving, self.seldom = self._kept[tile]
        return cells

    def around(self, tile: tuple[int, int]) -> Matrix:
        """(M, 3) the points of the eight tiles around, near the border."""
        low = np.array(tile) * TILE_M - BORDER_M
        high = low + TILE_M + 2 * BORDER_M
        found = []
        for x in (-1, 0, 1):
            for y in (-1, 0, 1):
                if x or y:
                    means = self.of((tile[0] + x, tile[1] + y)).means()
                    found.append(means[((means[:, :2] > low) & (means[:, :2] < high)).all(axis=1)])
        return np.concatenate(found)


def _normals(points: Matrix, around: Matrix) -> Matrix:
    """(N, 3) unit normals of points, from their neighbours among these and the points around."""
    import small_gicp

    middle = points.mean(axis=0)
    cloud = small_gicp.PointCloud(np.ascontiguousarray(np.concatenate([points, around]) - middle))
    small_gicp.estimate_normals(cloud, small_gicp.KdTree(cloud), NEIGHBOURS, 1)
    found: npt.NDArray[np.float64] = np.array(cloud.normals())[: len(points), :3]
    bad = ~(np.abs(np.linalg.norm(found, axis=1) - 1) < 0.1)
    found[bad] = (0.0, 0.0, 1.0)
    return found
