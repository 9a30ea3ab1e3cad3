"""Windows of a map that is served on the network. Tiles come in the background, and from memory the second time."""

from __future__ import annotations

import math
import threading
import time
from typing import Final

import numpy as np

from lidarcodec.evaluation.rigid import Matrix
from lidarcodec.maps.file import TILE_M
from lidarcodec.maps.localise.search import BLOCK
from lidarcodec.maps.localise.search import REACH_M as SEARCHED_M
from lidarcodec.maps.localise.window import KEPT_M, MOST_POINTS, REACH_M, MissingTilesError, Windows
from lidarcodec.maps.points import MapFrame, MapPoints
from lidarcodec.maps.served.sources import NetworkTiles
from lidarcodec.maps.served.stores import MemoryPieces
from lidarcodec.maps.served.tiles import MapTiles
from lidarcodec.maps.world import FEWEST, MapWorld
from lidarcodec.transport import Transport

AHEAD_M: Final = 50.0
"""Tiles this much farther away than the tracker needs are fetched, so that they are here when it does."""
WAIT_S: Final = 3.0
"""Longest time that tiles are waited for."""
ANEW_S: Final = 1.0
"""Shortest time between two windows at one place, while tiles come."""
SLICE_S: Final = 0.2
CACHE_BYTES: Final = 256 * 2**20


class ServedWindow:
    """As of Window. Tiles that have not come are missing in it, or, if it is strict, raise MissingTilesError."""

    def __init__(self, tiles: MapTiles, *, strict: bool) -> None:
        self._tiles, self._strict = tiles, strict
        self._made: tuple[Matrix, MapWorld | None] | None = None
        self._serial, self._made_s, self._waited = -1, 0.0, False

    @property
    def places(self) -> list[tuple[int, int]]:
        """As of Window."""
        return self._tiles.places

    @property
    def frame(self) -> MapFrame:
        """As of Window."""
        return self._tiles.head.frame

    @property
    def damaged_tiles(self) -> frozenset[tuple[int, int]]:
        """As of Window; such tiles are missing, and tried again."""
        return frozenset(self._tiles.damaged)

    def close(self) -> None:
        """End the fetching."""
        self._tiles.close()

    def around(self, place: Matrix) -> MapWorld | None:
        """As of Window. Waits at most WAIT_S, and once only while nothing comes."""
        made, now_s = self._made, time.monotonic()
        near = made is not None and np.linalg.norm(made[0][:2] - place[:2]) <= KEPT_M
        anew = self._serial != self._tiles.serial and now_s - self._made_s >= ANEW_S
        if made is not None and near and not anew:
            return made[1]
        points = self.points(place[:2] - REACH_M, place[:2] + REACH_M)
        world = MapWorld(points) if len(points) >= FEWEST else None
        self._made, self._made_s = (place.copy(), world), now_s
        return world

    def points(self, low: Matrix, high: Matrix) -> MapPoints:
        """As of Window."""
        self._tiles.move(*((low + high) / 2).tolist())
        if not self._waited or self._strict or self._serial != self._tiles.serial:
            here = self._tiles.wait(WAIT_S) if self._strict or not len(self._tiles.points()) else True
            self._waited = True
            if self._strict and not here:
                raise MissingTilesError(f"{self._tiles.state().missing} tiles of the map have not arrived yet")
        self._serial = self._tiles.serial
        points = self._tiles.points()
        least, most = np.floor(low / TILE_M), np.floor(high / TILE_M)
        tile = points.steps[:, :2] // round(TILE_M / points.step_m)
        inside = np.logical_and(tile >= least, tile <= most).all(axis=1)
        return points.taken(np.flatnonzero(inside))


def served_tiles(name: str, transport: Transport, patience_s: float) -> NetworkTiles:
    """The tiles of a served map. patience_s: for its list of tiles. Raises SourceError if no map can have this name."""
    return NetworkTiles(name, lambda: transport, MemoryPieces(CACHE_BYTES), patience_s)


def served_windows(
    source: NetworkTiles, start: tuple[float, float] | None = None, stop: threading.Event | None = None
) -> Windows:
    """Windows of a served map.

    start: a position whose tiles are waited for, as long as the source's patience;  stop: ends that

    Raises SourceError if nobody serves the map.
    """
    patience_s = source.patience_s
    across = BLOCK * TILE_M / 2 + SEARCHED_M
    reaches = (REACH_M + AHEAD_M, math.hypot(across, across))
    first = MapTiles(source, radius_m=reaches[0], max_points=MOST_POINTS)
    try:
        second = MapTiles(source, radius_m=reaches[1], max_points=MOST_POINTS)
    except BaseException:
        first.close()
        raise
    if start is not None:
        first.move(*start)
        end_s = time.monotonic() + patience_s
        while not first.wait(SLICE_S) and time.monotonic() < end_s and not (stop and stop.is_set()):
            pass
    source.patience_s = math.inf  # the vehicle drives on, and the network comes back
    return Windows(ServedWindow(first, strict=False), ServedWindow(second, strict=True))
