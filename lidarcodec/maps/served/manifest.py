"""Manifest: what a map consists of, so that a client fetches only what changed. Pieces are known by their SHA-256.

As JSON it comes in pages; docs/wire-format-maps.md, "On the network", has its fields.
"""

from __future__ import annotations

import base64
import binascii
import math
import re
from dataclasses import dataclass
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

    @property
    def size(self) -> int:
        """Bytes of all tiles and the path."""
        return self.path.size + sum(tile.size for tile in self.tiles)

    def summary(self) -> dict[str, Any]:
        """The map in a list of maps: JSON."""
        head, frame = self.about.head, self.about.head.frame
        places = [tile.place for tile in self.tiles if tile.place is not None]
        xs, ys = [x for x, _ in places], [y for _, y in places]
        bounds = [min(xs), min(ys), max(xs) + 1, max(ys) + 1] if places else []
        return {
            "name": self.name,
            "version": self.version,
            "points": self.about.points,
            "bytes": self.size,
            "tiles": len(places),
            "tile_m": TILE_M,
            "step_m": head.step_m,
            "length_m": round(self.about.length_m, 1),
            "frame": f"UTM {frame.zone}{'S' if frame.south else 'N'}" if frame.zone else "local",
            "origin": list(frame.origin) if frame.zone else None,
            "bounds_m": [TILE_M * one for one in bounds] or None,
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


def manifest_of(name: str, pages: list[dict[str, Any]]) -> Manifest:
    """The manifest that pages of one version make. Raises SourceError for pages that make no sense."""
    try:
        head = base64.b64decode(pages[0]["head"], validate=True)
        about = about_of(head)
        version = _hash(pages[0]["version"])
        path = Piece(None, *_sized(pages[0]["path"], 0, MAX_PATH_BYTES))
        tiles = tuple(_tile(told) for page in pages for told in page["places"])
    except (KeyError, TypeError, ValueError, binascii.Error, DecodeError) as error:
        raise SourceError(f"the list of tiles of map '{name}' makes no sense: {error}") from None
    if len(head) != HEAD_BYTES or about.path_places > MOST_PATH or about.tiles != len(tiles):
        raise SourceError(f"the list of tiles of map '{name}' does not agree with the head of the map")
    if len({tile.place for tile in tiles}) != len(tiles):
        raise SourceError(f"the list of tiles of map '{name}' has two tiles at one place")
    return Manifest(name, version, head, about, path, tiles)


def check_map_name(name: str) -> str:
    """The name itself. Raises SourceError if no map can have it."""
    if not is_name(name) or not name.strip("."):
        raise SourceError(f"'{name}' cannot be the name of a map: it has 1 to 64 of A-Z a-z 0-9 _ . -")
    return name


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
        raise ValueError("a hash that is none")
    return told
