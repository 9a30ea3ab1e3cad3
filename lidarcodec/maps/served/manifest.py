"""Manifest: what a map consists of, so that a client fetches only what changed. Pieces are known by their SHA-256.

As JSON it comes in pages; docs/wire-format-maps.md, "On the network", has its fields.
"""

from __future__ import annotations

import base64
import binascii
import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, NamedTuple

from lidarcodec.errors import DecodeError, SourceError
from lidarcodec.maps.file import HEAD_BYTES, MOST_PATH, TILE_M, About, about_of
from lidarcodec.maps.tiles import MOST_PLACE
from lidarcodec.settings import is_name
from lidarcodec.transport.keys import PREFIX

KEY: Final = f"{PREFIX}/@maps"
HASH: Final = re.compile(r"[0-9a-f]{64}")
PATH: Final = "path"
"""Last part of the key of a map's path; tiles have two numbers there."""
PAGE: Final = 4000
"""Tiles of a page: its JSON has less bytes than an answer may have."""
MAX_TILES: Final = 200_000
"""500 square kilometres."""
MAX_TILE_BYTES: Final = 16 * 2**20
"""No tile of 4 million points has more."""
SUMMARY: Final = (
    "name", "version", "points", "bytes", "tiles", "tile_m", "step_m", "length_m", "frame", "origin", "bounds_m",
)  # fmt: skip
"""Fields of a map in a list of maps."""
MAX_PATH_BYTES: Final = 16 * MOST_PATH


class Piece(NamedTuple):
    """A tile or the path. place: x and y of a tile in its widths, None for the path;  hash: SHA-256 of its bytes"""

    place: tuple[int, int] | None
    size: int
    hash: str

    @property
    def tail(self) -> str:
        """The end of its key."""
        return PATH if self.place is None else f"{self.place[0]}/{self.place[1]}"

    def distance_m(self, x_m: float, y_m: float) -> float:
        """From a position to the nearest place of the tile."""
        assert self.place is not None
        x, y = (TILE_M * one for one in self.place)
        return math.hypot(max(x - x_m, x_m - x - TILE_M, 0.0), max(y - y_m, y_m - y - TILE_M, 0.0))


@dataclass(frozen=True)
class Manifest:
    """A map that is served.

    version: SHA-256 of its file;  head: the first bytes of the file;  about: what they say
    """

    name: str
    version: str
    head: bytes
    about: About
    path: Piece
    tiles: tuple[Piece, ...]

    @cached_property
    def size(self) -> int:
        """Bytes of all tiles and the path."""
        return self.path.size + sum(tile.size for tile in self.tiles)

    @cached_property
    def by_place(self) -> dict[tuple[int, int], Piece]:
        """The tiles by their place, in the order of the file."""
        return {tile.place: tile for tile in self.tiles if tile.place is not None}

    @cached_property
    def bounds_m(self) -> tuple[int, int, int, int] | None:
        """Smallest x and y, and largest x and y, of the tiles; None if there are none."""
        if not self.by_place:
            return None
        xs, ys = {x for x, _ in self.by_place}, {y for _, y in self.by_place}
        return TILE_M * min(xs), TILE_M * min(ys), TILE_M * (max(xs) + 1), TILE_M * (max(ys) + 1)

    def near(self, x_m: float, y_m: float, radius_m: float) -> list[tuple[float, Piece]]:
        """Tiles within a distance of a position, the nearest first, each behind its distance in metres."""
        tiles: Iterable[Piece] = self.tiles
        if 2 * radius_m / TILE_M + 3 < math.sqrt(len(self.tiles)):  # then looking around is less work
            columns, rows = (
                range(math.floor((at - radius_m) / TILE_M), math.floor((at + radius_m) / TILE_M) + 1)
                for at in (x_m, y_m)
            )
            tiles = [self.by_place[x, y] for x in columns for y in rows if (x, y) in self.by_place]
        found = [(tile.distance_m(x_m, y_m), tile) for tile in tiles]
        return sorted((one for one in found if one[0] <= radius_m), key=lambda one: one[0])

    def summary(self) -> dict[str, Any]:
        """The map in a list of maps: JSON."""
        head, frame = self.about.head, self.about.head.frame
        return {
            "name": self.name,
            "version": self.version,
            "points": self.about.points,
            "bytes": self.size,
            "tiles": len(self.tiles),
            "tile_m": TILE_M,
            "step_m": head.step_m,
            "length_m": round(self.about.length_m, 1),
            "frame": f"UTM {frame.zone}{'S' if frame.south else 'N'}" if frame.zone else "local",
            "origin": list(frame.origin) if frame.zone else None,
            "bounds_m": self.bounds_m and list(self.bounds_m),
        }

    def page(self, begin: int) -> dict[str, Any]:
        """The tiles from one on, as many as fit, with all else: JSON."""
        tiles = [[*(tile.place or ()), tile.size, tile.hash] for tile in self.tiles[begin : begin + PAGE]]
        return {
            **self.summary(),
            "head": base64.b64encode(self.head).decode(),
            "path": [self.path.size, self.path.hash],
            "from": begin,
            "places": tiles,
        }


def manifest_of(name: str, pages: Iterable[dict[str, Any]]) -> Manifest:
    """The manifest that pages of one version make; of each, only its tiles are kept. All but the last are full.

    Raises SourceError for pages that make no sense.
    """
    head, tiles, full = b"", list[Piece](), True
    try:
        for page in pages:
            places = page["places"]
            if not head:
                head = base64.b64decode(page["head"], validate=True)
                about = about_of(head)
                version = _hash(page["version"])
                path = Piece(None, *_sized(page["path"], 0, MAX_PATH_BYTES))
            tiles += _tiles(places, PAGE if full else 0)
            full = len(places) == PAGE
    except (KeyError, TypeError, ValueError, binascii.Error, DecodeError) as error:
        raise SourceError(f"the list of tiles of map '{name}' cannot be understood: {error}") from None
    if len(head) != HEAD_BYTES or about.path_places > MOST_PATH or about.tiles != len(tiles):
        raise SourceError(f"the list of tiles of map '{name}' does not match the header of the map")
    if len({tile.place for tile in tiles}) != len(tiles):
        raise SourceError(f"the list of tiles of map '{name}' has two tiles at one place")
    return Manifest(name, version, head, about, path, tuple(tiles))


def check_map_name(name: str) -> str:
    """The name itself. Raises SourceError if no map can have it."""
    if not is_name(name) or not name.strip("."):
        raise SourceError(f"'{name}' cannot be the name of a map: use 1 to 64 of A-Z a-z 0-9 _ . -")
    return name


def _tiles(places: Any, most: int) -> list[Piece]:
    """The tiles of a page."""
    if len(places) > most:
        raise ValueError(f"a page of {len(places)} tiles")
    return [_tile(told) for told in places]


def _tile(told: Any) -> Piece:
    x, y, *rest = told
    for number in (x, y):
        if not isinstance(number, int) or isinstance(number, bool) or abs(number) > MOST_PLACE:
            raise ValueError("the place of a tile")
    return Piece((x, y), *_sized(rest, 1, MAX_TILE_BYTES))


def _sized(told: Any, least: int, most: int) -> tuple[int, str]:
    """The size and the hash of a piece."""
    size, name = told
    if not isinstance(size, int) or isinstance(size, bool) or not least <= size <= most:
        raise ValueError(f"a piece of {size!r:.40} bytes")
    return size, _hash(name)


def _hash(told: Any) -> str:
    if not isinstance(told, str) or not HASH.fullmatch(told):
        raise ValueError("a hash is not valid")
    return told
