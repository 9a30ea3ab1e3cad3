"""Decoded tiles for the page: positions as 32-bit floats, compressed. What was asked for last is kept, up to a limit.

The page's decoder knows messages of streams and no maps, so the server decodes for it.
"""

from __future__ import annotations

import gzip
import threading
from collections import OrderedDict
from typing import Final

import numpy as np

from lidarcodec.errors import DecodeError, SourceError
from lidarcodec.maps.file import TILE_M, Head
from lidarcodec.maps.served.manifest import Piece
from lidarcodec.maps.served.shelf import ShelvedMap
from lidarcodec.maps.tiles import decode_tile, place_in, points_in

MOST_DRAWN: Final = 100_000
"""Points of a tile that are handed out; of others every second, third and so on."""
MOST_DECODED: Final = 1_000_000
"""Tiles with more points are not drawn: they would take too much memory here."""
MAX_BYTES: Final = 64 * 2**20
MAX_REFUSED: Final = 1_000
Key = tuple[Piece, int, tuple[tuple[str, int], ...]]


class TilePoints:
    """Points of tiles. Thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._kept: OrderedDict[Key, bytes] = OrderedDict()
        self._refused: OrderedDict[Key, str] = OrderedDict()
        """Why tiles cannot be drawn: to decode one until its error may take seconds, and a page asks every ten."""
        self._bytes = 0

    def packed(self, shelved: ShelvedMap, tile: Piece) -> bytes:
        """The points of a tile as gzip of (N, 3) little endian float32, metres: x and y from the corner of the tile, z
        of the map.

        Raises SourceError if the tile cannot be read, or has more than MOST_DECODED points; DecodeError.
        """
        head = shelved.manifest.about.head
        # Not by its hash alone: another map may have the same bytes at another place, or read them otherwise.
        key = tile, head.step_um, tuple(head.columns.items())
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
            if key in self._refused:
                raise SourceError(self._refused[key])
        data = shelved.read(tile)
        try:
            packed = gzip.compress(_points(data, head, tile), 6)
        except (SourceError, DecodeError) as error:
            damaged = f"tile {tile.tail} of map '{shelved.name}' is damaged: " * isinstance(error, DecodeError)
            with self._lock:
                self._refused[key] = f"{damaged}{error}"
                while len(self._refused) > MAX_REFUSED:
                    self._refused.popitem(last=False)
                raise SourceError(self._refused[key]) from None
        with self._lock:
            if key not in self._kept:
                self._kept[key] = packed
                self._bytes += len(packed)
            while self._bytes > MAX_BYTES and len(self._kept) > 1:
                self._bytes -= len(self._kept.popitem(last=False)[1])
        return packed


def _points(data: bytes, head: Head, piece: Piece) -> bytes:
    count = points_in(data)
    if count > MOST_DECODED:
        raise SourceError(f"the tile has {count:,} points, which are too many to draw: the limit is {MOST_DECODED:,}")
    if place_in(data) != piece.place:
        raise SourceError(f"tile {piece.tail} cannot be drawn: it is the tile of another place")
    tile = decode_tile(data, head.width, head.bits)
    steps = tile.steps[:: -(-count // MOST_DRAWN)]
    corner = np.array([tile.x * TILE_M, tile.y * TILE_M, 0.0])
    return bytes((steps * head.step_m - corner).astype("<f4").tobytes())
