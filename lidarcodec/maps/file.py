"""Files of maps, `.lcmap`: a head, tiles, the path of the sensor, and an index. docs/wire-format-maps.md defines them.

>>> from io import BytesIO
>>> file = BytesIO()
>>> points = MapPoints(0.02, np.array([[0, 0, 0], [10, 0, 1], [2600, 0, 0]]))
>>> write_map(file, points)
>>> with MapReader(file) as town:
...     len(town.places), len(town), len(town.points())
(2, 3, 3)
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Final, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from lidarcodec import _native
from lidarcodec.entropy.varint import VarintReader, put_signed, put_varint
from lidarcodec.errors import (
    ChecksumError,
    DecodeError,
    HeaderError,
    SettingsError,
    SourceError,
    TruncatedError,
    UnsupportedVersionError,
)
from lidarcodec.files.regular import open_regular
from lidarcodec.maps.points import COLUMNS, LOCAL, MapFrame, MapPoints
from lidarcodec.maps.tiles import MOST_PLACE, POINTS_PER_BYTE, Tile, decode_tile, encode_tile, place_in, tiles_of

MAGIC: Final = b"LCMAP\r\n\x1a"
VERSION: Final = (1, 0)
TILE_M: Final = 50
HEAD: Final = struct.Struct("<8s BB BB I I B?2x 3d d QI QI QQ 8B8B")
"""Magic, version, columns, 0, step in micrometres, steps of a tile, UTM zone, south, origin, length, offset and number
of the path, offset and number of the index, points, 0, names and bits of columns. A CRC-32C follows."""
HEAD_BYTES: Final = HEAD.size + 4
LEAST_STEP_UM, MOST_STEP_UM = 1_000, 1_000_000
MOST_PATH: Final = 1 << 16
MOST_PATH_CM: Final = 1 << 31


class Place(NamedTuple):
    """A tile in a file: its place in widths of a tile, its first byte, and its bytes."""

    x: int
    y: int
    offset: int
    size: int


@dataclass(frozen=True)
class Head:
    """step_um: step of coordinates in micrometres; width: of a tile in steps; columns: their names and bits"""

    step_um: int
    columns: Mapping[str, int]
    frame: MapFrame = LOCAL

    @property
    def step_m(self) -> float:
        """The step in metres."""
        return self.step_um / 1e6

    @property
    def width(self) -> int:
        """Steps of a tile."""
        return round(TILE_M / self.step_m)

    @property
    def bits(self) -> list[int]:
        """Bits of the values of each column."""
        return list(self.columns.values())


class About(NamedTuple):
    """What the head of a file says: how points are coded, length of all drives in metres, where path and index begin,
    how many places and tiles they have, and the number of points."""

    head: Head
    length_m: float
    path_at: int
    path_places: int
    index_at: int
    tiles: int
    points: int


def about_of(data: bytes) -> About:
    """What the head of a file says. data: its first HEAD_BYTES bytes

    Raises HeaderError, TruncatedError, ChecksumError.
    """
    if data[: len(MAGIC)] != MAGIC:
        raise HeaderError("this is not a map of lidarcodec", 0)
    if len(data) < HEAD_BYTES:
        raise TruncatedError("the map ends too early", len(data))
    fields = HEAD.unpack(_checked(data[:HEAD_BYTES], 0))
    return About(_head_of(fields), *fields[12:18])


def check_step(step_um: int) -> None:
    """Raise SettingsError for a step that a map cannot have. Tiles of 50 m are a whole number of steps wide."""
    if not LEAST_STEP_UM <= step_um <= MOST_STEP_UM or TILE_M * 1_000_000 % step_um:
        raise SettingsError(
            f"a step of {step_um / 1e6:g} m is not possible: choose 0.001 to 1 m that divides 50 m, such as "
            "0.01 or 0.02",
            "step",
        )


class MapWriter:
    """Writes a map tile by tile, to a file that can be read back and forth. `close` completes it."""

    def __init__(self, file: BinaryIO, head: Head) -> None:
        """Raises SettingsError for a step that a map cannot have."""
        check_step(head.step_um)
        self._file, self._head = file, head
        self._places: list[tuple[int, int, int]] = []
        self._points = 0
        file.seek(0)
        file.write(bytes(HEAD_BYTES))

    def write(self, tile: Tile) -> None:
        """Append a tile. Raises SettingsError."""
        if max(abs(tile.x), abs(tile.y), abs(int(tile.steps[:, 2].min()))) >= MOST_PLACE // 2:
            raise SettingsError("a point of the map is too far from the origin: check the poses")
        head = self._head
        self.append(tile.x, tile.y, encode_tile(tile, head.width, head.step_m, head.bits), len(tile.steps))

    def append(self, x: int, y: int, data: bytes, points: int) -> None:
        """Append a tile that is coded. points: how many it has"""
        self._file.write(data)
        self._places.append((x, y, len(data)))
        self._points += points

    def close(self, path: npt.NDArray[np.floating], length_m: float) -> None:
        """Write the path, the index and the head. path: (P, 3) in metres"""
        if np.abs(path).max(initial=0.0) * 100 >= MOST_PATH_CM // 2:
            raise SettingsError("the path of the map leads too far from the origin: check the poses")
        self.end(_with_crc(_path_bytes(path)), len(path), length_m)

    def end(self, path: bytes, path_places: int, length_m: float) -> None:
        """Write a path that is coded, the index and the head."""
        path_at = self._file.tell()
        self._file.write(path)
        index_at = self._file.tell()
        index, before = bytearray(), (0, 0)
        for x, y, size in self._places:
            put_signed(index, x - before[0])
            put_signed(index, y - before[1])
            put_varint(index, size)
            before = x, y
        self._file.write(_with_crc(bytes(index)))
        head = self._head
        names = [COLUMNS[name] for name in head.columns]
        packed = HEAD.pack(
            MAGIC, *VERSION, len(names), 0, head.step_um, head.width, head.frame.zone, head.frame.south,
            *head.frame.origin, length_m, path_at, path_places, index_at, len(self._places), self._points, 0,
            *_eight(names), *_eight(head.bits),
        )  # fmt: skip
        self._file.seek(0)
        self._file.write(_with_crc(packed))
        self._file.seek(0, 2)


def write_map(file: BinaryIO, points: MapPoints) -> None:
    """Write a whole map. Raises SettingsError."""
    bits = {name: max(int(values.max(initial=1)).bit_length(), 1) for name, values in points.columns.items()}
    head = Head(round(points.step_m * 1e6), bits, points.frame)
    columns = np.stack(list(points.columns.values()), axis=1) if bits else np.empty((len(points), 0), np.uint16)
    writer = MapWriter(file, head)
    for tile in tiles_of(points.steps, columns, head.width):
        writer.write(tile)
    writer.close(points.path, points.length_m)


class MapReader:
    """A map in a file, whose tiles are read when they are asked for.

    about, head, places, length_m, path: what the file says;  len: number of its points
    """

    def __init__(self, file: BinaryIO) -> None:
        """Reads head, path and index, and checks all places. Raises HeaderError, TruncatedError, ChecksumError,
        SectionError."""
        self._file = file
        self._size = file.seek(0, 2)
        self.about = about = about_of(self._take(0, min(HEAD_BYTES, self._size)))
        self.head, self.length_m, path_at, path_count, index_at, tiles, self._points = about
        if not HEAD_BYTES <= path_at <= index_at <= self._size - 4:
            raise HeaderError("the parts of the map are not where its header says", 0)
        if tiles > index_at or path_count > min(MOST_PATH, index_at - path_at):
            raise HeaderError("the map has more tiles, or more places on its path, than its bytes can hold", 0)
        self.path = path_of(self._take(path_at, index_at - path_at), path_count)
        self.places = _places_of(_checked(self._take(index_at, self._size - index_at), index_at), tiles, path_at)
        if self._points > POINTS_PER_BYTE * (path_at - HEAD_BYTES):
            raise HeaderError("a map has more points than its bytes can hold", 0)

    @classmethod
    def open(cls, path: Path) -> Self:
        """The map in a file. Raises SourceError if it cannot be read or is damaged."""
        try:
            file = open_regular(path)
        except OSError as error:
            raise SourceError(f"cannot read {path}: {error.strerror or error}") from None
        try:
            return cls(file)
        except DecodeError as error:
            file.close()
            raise SourceError(f"cannot read the map {path}: {error}") from None
        except BaseException:
            file.close()
            raise

    def __len__(self) -> int:
        return int(self._points)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file. A second call does nothing."""
        self._file.close()

    def tile(self, place: Place) -> Tile:
        """A tile of `places`. Raises ChecksumError, TruncatedError, SectionError."""
        data = self._take(place.offset, place.size)
        if place_in(data) != (place.x, place.y):  # before it is decoded, which may take seconds
            raise HeaderError("a tile of the map does not match the index", place.offset)
        return decode_tile(data, self.head.width, self.head.bits)

    def tiles(self) -> Iterator[Tile]:
        """All tiles, in the order of the file."""
        return map(self.tile, self.places)

    def points(self) -> MapPoints:
        """The whole map in memory, about 40 bytes a point. Raises as `tile`, HeaderError for another number of points
        than the head says."""
        tiles = list(self.tiles())
        steps = np.concatenate([tile.steps for tile in tiles]) if tiles else np.empty((0, 3), np.int64)
        if len(steps) != len(self):
            raise HeaderError(f"the map has {len(steps)} points, but its header says {len(self)}", 0)
        columns = {
            name: np.concatenate([tile.columns[:, at] for tile in tiles]) if tiles else np.empty(0, np.uint16)
            for at, name in enumerate(self.head.columns)
        }
        return MapPoints(self.head.step_m, steps, columns, self.path, self.length_m, self.head.frame)

    def _take(self, offset: int, size: int) -> bytes:
        self._file.seek(offset)
        data = self._file.read(size)
        if len(data) < size:
            raise TruncatedError("the map ends too early", offset + len(data))
        return data


def read_map(path: Path) -> MapPoints:
    """The whole map in a file. Raises SourceError if it cannot be read or is damaged."""
    with MapReader.open(path) as reader:
        try:
            return reader.points()
        except DecodeError as error:
            raise SourceError(f"cannot read the map {path}: {error}") from None


def _head_of(fields: tuple[Any, ...]) -> Head:
    _, major, minor, columns, _, step_um, width, zone, south, *rest = fields
    if major != VERSION[0]:
        raise UnsupportedVersionError(
            f"the map has version {major}.{minor!r}, but this program reads version {VERSION[0]}", 8
        )
    names = {number: name for name, number in COLUMNS.items()}
    numbers, bits = fields[19:27], fields[27:35]
    known = {names.get(number, ""): bit for number, bit in zip(numbers[:columns], bits, strict=False)}
    if (
        columns > len(names)
        or "" in known
        or len(known) != columns
        or ("normal_a" in known) != ("normal_b" in known)
        or not all(1 <= bit <= 16 for bit in known.values())
    ):
        raise HeaderError("the map has columns that this program does not know", HEAD.size - 16)
    if not LEAST_STEP_UM <= step_um <= MOST_STEP_UM or TILE_M * 1_000_000 % step_um or zone > 60:
        raise HeaderError("the map has an impossible step, or a UTM zone that does not exist", 12)
    if not all(np.isfinite(number) for number in rest[:4]):
        raise HeaderError("the origin or the length of a map is not a number", 24)
    head = Head(int(step_um), known, MapFrame(int(zone), bool(south), (rest[0], rest[1], rest[2])))
    if width != head.width:
        raise HeaderError(f"a map has tiles of {width} steps instead of {head.width}", 16)
    return head


def _eight(numbers: list[int]) -> list[int]:
    return numbers + [0] * (8 - len(numbers))


def _with_crc(data: bytes) -> bytes:
    return data + _native.crc32c(data).to_bytes(4, "little")


def _checked(data: bytes, offset: int) -> bytes:
    if len(data) < 4:
        raise TruncatedError("a part of the map is shorter than its checksum", offset)
    if _native.crc32c(data[:-4]) != int.from_bytes(data[-4:], "little"):
        raise ChecksumError("the checksum of a part of a map does not match", offset)
    return data[:-4]


def _path_bytes(path: npt.NDArray[np.floating]) -> bytes:
    out, before = bytearray(), np.zeros(3, np.int64)
    for place in np.rint(np.asarray(path, np.float64) * 100).astype(np.int64):
        for number in (place - before).tolist():
            put_signed(out, number)
        before = place
    return bytes(out)


def path_of(data: bytes, count: int) -> npt.NDArray[np.float32]:
    """The places (P, 3) in metres of a coded path. Raises ChecksumError, TruncatedError, SectionError."""
    reader = VarintReader(_checked(data, 0))
    steps = [[reader.signed(MOST_PATH_CM) for _ in range(3)] for _ in range(count)]
    if len(reader):
        raise TruncatedError("the map has bytes after the end of its path", reader.offset)
    return (np.cumsum(np.array(steps, np.int64).reshape(-1, 3), axis=0) / 100).astype(np.float32)


def _places_of(data: bytes, count: int, end: int) -> list[Place]:
    reader, places, x, y, offset = VarintReader(data), list[Place](), 0, 0, HEAD_BYTES
    for _ in range(count):
        x, y = x + reader.signed(MOST_PLACE), y + reader.signed(MOST_PLACE)
        size = reader.varint(end - offset, 5)
        if max(abs(x), abs(y)) > MOST_PLACE:
            raise HeaderError("a tile of a map lies too far away", 0)
        places.append(Place(x, y, offset, size))
        offset += size
    if offset != end or len(reader):
        raise HeaderError("the tiles of the map do not have the size in its header", offset)
    if len({(place.x, place.y) for place in places}) != len(places):
        raise HeaderError("the map has two tiles at the same place", 0)
    return places
