"""Tiles: squares of 50 m of a map, each coded by itself. docs/wire-format-maps.md defines the bytes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec import _native
from lidarcodec.entropy.varint import VarintReader, put_signed, put_varint
from lidarcodec.errors import ChecksumError, SectionError, SettingsError, TruncatedError
from lidarcodec.maps.points import Steps, Values

CELL_M: Final = 0.2
"""Width of the cells of a map that is built: there is at most one point in each."""
MOST_POINTS: Final = 4_000_000
POINTS_PER_BYTE: Final = 4
"""A tile has at most this many points for each byte, so that a small file cannot ask for much memory. Real ones have
less than one; an encoder fills up the bytes of others with zeros."""
MOST_PLACE: Final = 1 << 31
"""Largest number of a tile, and largest height of its lowest step."""
FORMS: Final = ((1, 3), (1, 10), (2, 5))
"""Width in cells of CELL_M, and reach, that an encoder tries. Of a dense tile only the first one."""
DENSE: Final = 20_000


class Tile(NamedTuple):
    """x, y: its place, in widths of a tile; steps: (N, 3) int64, in the map; columns: (N, columns) uint16"""

    x: int
    y: int
    steps: Steps
    columns: Values


def encode_tile(tile: Tile, width: int, step_m: float, bits: Sequence[int]) -> bytes:
    """The bytes of a tile. width: of a tile in steps; bits: of the values of each column.

    Raises SettingsError if two points are alike, or one lies outside of the tile.
    """
    corner = np.array([tile.x * width, tile.y * width, tile.steps[:, 2].min()])
    cell = max(round(CELL_M / step_m), 1)
    corner[2] -= corner[2] % cell
    local = (tile.steps - corner).astype(np.int64)
    if local.min() < 0 or local[:, :2].max() >= width:
        raise SettingsError("a point lies outside of its tile")
    if _alike(local):
        raise SettingsError("two points of the map are the same")
    points, values = local.astype(np.uint32), np.ascontiguousarray(tile.columns)
    found: tuple[bytes, tuple[int, int, int]] | None = None
    for cells, reach in FORMS[: 1 if len(local) > DENSE else None]:
        levels = int(local.max() // (cell * cells)).bit_length()
        if levels > 16:
            raise SettingsError("a tile of the map is too high for its step")
        data = _native.encode_tile(points, values, levels, cell * cells, reach, list(bits))
        if found is None or len(data) < len(found[0]):
            found = data, (levels, cell * cells, reach)
    assert found is not None
    body = bytearray()
    for number in (tile.x, tile.y, int(corner[2])):
        put_signed(body, number)
    padding = max(-(-len(local) // POINTS_PER_BYTE) - len(body) - len(found[0]), 0)
    for number in (len(local), *found[1], padding):
        put_varint(body, number)
    body += bytes(padding) + found[0]
    return _native.crc32c(bytes(body)).to_bytes(4, "little") + bytes(body)


def points_in(data: bytes) -> int:
    """The number of points that a coded tile says it has, without decoding it.

    Raises ChecksumError, TruncatedError, SectionError.
    """
    return _opened(data)[1]


def place_in(data: bytes) -> tuple[int, int]:
    """The place that a coded tile says it has, in widths of a tile, without decoding it.

    Raises ChecksumError, TruncatedError, SectionError.
    """
    x, y, _ = _opened(data)[0]
    return x, y


def decode_tile(data: bytes, width: int, bits: Sequence[int]) -> Tile:
    """The tile of `encode_tile`. Memory is bounded: 4 points a byte, and 4 million points.

    Raises ChecksumError, TruncatedError, SectionError.
    """
    (x, y, z), count, reader = _opened(data)
    levels, cell, reach = reader.varint(16), reader.varint(1024, 1), reader.varint(256, 1)
    padding = reader.take(reader.varint(len(data)))
    if padding.count(0) != len(padding):
        raise SectionError("the padding of a tile of a map is not zero", 4)
    points, columns = _native.decode_tile(reader.take(len(reader)), count, levels, cell, reach, list(bits))
    steps = points.astype(np.int64)
    if steps[:, :2].max() >= width:
        raise SectionError("a tile of a map has a point outside of it", 4)
    if _alike(steps):
        raise SectionError("a tile of the map has the same point twice", 4)
    steps += np.array([x * width, y * width, z])
    return Tile(x, y, steps, columns)


def _opened(data: bytes) -> tuple[list[int], int, VarintReader]:
    """Place and lowest step of a coded tile, the number of its points, and what follows."""
    if len(data) < 4:
        raise TruncatedError("a tile of the map is shorter than its checksum", len(data))
    if _native.crc32c(data[4:]) != int.from_bytes(data[:4], "little"):
        raise ChecksumError("the checksum of a tile of a map does not match", 0)
    reader = VarintReader(data[4:])
    place = [reader.signed(MOST_PLACE) for _ in range(3)]
    return place, reader.varint(min(MOST_POINTS, POINTS_PER_BYTE * len(data)), 1), reader


def _alike(steps: Steps) -> bool:
    """Whether two points (N, 3) are alike."""
    ordered = steps[np.lexsort(steps.T)]
    return bool((np.diff(ordered, axis=0) == 0).all(axis=1).any())


def tiles_of(steps: Steps, columns: Values, width: int) -> Iterable[Tile]:
    """The points (N, 3) with their columns (N, columns), tile by tile in the order of (y, x)."""
    places = np.floor_divide(steps[:, :2], width)
    order = np.lexsort((places[:, 0], places[:, 1]))
    ends = np.flatnonzero((np.diff(places[order], axis=0) != 0).any(axis=1)) + 1
    for chosen in np.split(order, ends) if len(order) else ():
        x, y = places[chosen[0]]
        yield Tile(int(x), int(y), steps[chosen], columns[chosen])


def unlike(steps: Steps) -> npt.NDArray[np.intp]:
    """The places of the first of all points that are alike, in increasing order."""
    found = np.unique(steps, axis=0, return_index=True)[1]
    return np.sort(found)
