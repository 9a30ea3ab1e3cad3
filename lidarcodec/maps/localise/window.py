"""MapWindow: the part of a map around a place, so that memory does not grow with the map."""

from __future__ import annotations

import logging
from typing import Final, NamedTuple, Protocol

import numpy as np

from lidarcodec.errors import DecodeError, SourceError
from lidarcodec.evaluation.rigid import Matrix
from lidarcodec.evaluation.trajectory import FARTHEST_M
from lidarcodec.maps.file import TILE_M, MapReader, Place
from lidarcodec.maps.points import MapFrame, MapPoints
from lidarcodec.maps.tiles import Tile
from lidarcodec.maps.world import FEWEST, MapWorld

logger = logging.getLogger(__name__)

KEPT_M: Final = 20.0
"""The window is made anew when the place is farther than this from its middle."""
REACH_M: Final = FARTHEST_M + KEPT_M
MOST_POINTS: Final = 4_000_000
"""A whole map has about 200,000 points in a window."""


class MissingTilesError(SourceError):
    """Tiles of a map that is served have not come yet."""


class Window(Protocol):
    """The part of a map around a place, from a file or from the network."""

    @property
    def places(self) -> list[tuple[int, int]]:
        """All tiles of the map, in widths of a tile."""

    @property
    def frame(self) -> MapFrame:
        """The frame of the map."""

    @property
    def damaged_tiles(self) -> frozenset[tuple[int, int]]:
        """Tiles that cannot be decoded."""

    def around(self, place: Matrix) -> MapWorld | None:
        """The map around a place (3,) in metres; None if it has fewer than 50 points there. Raises SourceError."""

    def points(self, low: Matrix, high: Matrix) -> MapPoints:
        """The points of all tiles that meet the square from `low` (2,) to `high` (2,) in metres, with normals.

        Raises MissingTilesError, SourceError.
        """

    def close(self) -> None:
        """Give back what is held."""


class Windows(NamedTuple):
    """Two windows of one map: a search goes through it beside the tracker."""

    tracked: Window
    searched: Window


class MapWindow:
    """The tiles within 100 m of the last place. damaged: tiles that could not be decoded, each said once in the log"""

    def __init__(self, reader: MapReader, most_in_tile: int | None = None) -> None:
        """most_in_tile: of a tile with more points so many are taken by lot"""
        self.reader, self._most_in_tile = reader, most_in_tile
        self.damaged: set[Place] = set()
        self._tiles: dict[Place, Tile] = {}
        self._made: tuple[Matrix, MapWorld | None] | None = None

    @property
    def places(self) -> list[tuple[int, int]]:
        """As of Window."""
        return [(place.x, place.y) for place in self.reader.places]

    @property
    def frame(self) -> MapFrame:
        """As of Window."""
        return self.reader.head.frame

    @property
    def damaged_tiles(self) -> frozenset[tuple[int, int]]:
        """As of Window."""
        return frozenset((place.x, place.y) for place in self.damaged)

    def close(self) -> None:
        """Close the file."""
        self.reader.close()

    def around(self, place: Matrix) -> MapWorld | None:
        """The map around a place (3,) in metres; None if it has fewer than 50 points there.

        Raises SourceError if there are more than 4 million points.
        """
        if self._made is None or np.linalg.norm(self._made[0][:2] - place[:2]) > KEPT_M:
            points = self.points(place[:2] - REACH_M, place[:2] + REACH_M)
            self._made = place.copy(), MapWorld(points) if len(points) >= FEWEST else None
        return self._made[1]

    def points(self, low: Matrix, high: Matrix) -> MapPoints:
        """The points of all tiles that meet the square from `low` (2,) to `high` (2,) in metres, with normals.

        Raises SourceError if there are more than 4 million of them.
        """
        least, most = np.floor(low / TILE_M), np.floor(high / TILE_M)
        wanted = [
            place
            for place in self.reader.places
            if least[0] <= place.x <= most[0] and least[1] <= place.y <= most[1] and place not in self.damaged
        ]
        inside = set(wanted)
        self._tiles = {place: tile for place, tile in self._tiles.items() if place in inside}
        for place in wanted:
            if place not in self._tiles:
                self._read(place)
            if sum(len(tile.steps) for tile in self._tiles.values()) > MOST_POINTS:
                raise SourceError(
                    f"the map has more than {MOST_POINTS:,} points within {REACH_M:.0f} m: make it smaller with "
                    "`lidarcodec map compress`"
                )
        tiles, head = list(self._tiles.values()), self.reader.head
        steps = np.concatenate([tile.steps for tile in tiles]) if tiles else np.empty((0, 3), np.int64)
        columns = {
            name: np.concatenate([tile.columns[:, at] for tile in tiles]) if tiles else np.empty(0, np.uint16)
            for at, name in enumerate(head.columns)
            if name.startswith("normal")
        }
        return MapPoints(head.step_m, steps, columns, frame=head.frame)

    def _read(self, place: Place) -> None:
        try:
            self._tiles[place] = _thinned(self.reader.tile(place), self._most_in_tile)
        except DecodeError as error:
            self.damaged.add(place)
            logger.warning("the tile %d, %d of the map cannot be read and is left out: %s", place.x, place.y, error)


def _thinned(tile: Tile, most: int | None) -> Tile:
    """The tile, or some of its points by lot, always the same ones."""
    if most is None or len(tile.steps) <= most:
        return tile
    chosen = np.sort(np.random.default_rng(7).permutation(len(tile.steps))[:most])
    return tile._replace(steps=tile.steps[chosen], columns=tile.columns[chosen])
