"""The CLOUD section: one `sensor_msgs/PointCloud2` message. The format is docs/wire-format-clouds.md.

Whatever cannot be taken apart travels as it is, in a zstd frame, and the encoder decodes what it made before it gives
it away: so each message comes back byte for byte, or, with a bound, with all but x, y and z as it was.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec import _native
from lidarcodec.entropy.varint import VarintReader, put_varint
from lidarcodec.entropy.zstd_frames import compress, decompress
from lidarcodec.errors import LidarCodecError, SectionError
from lidarcodec.planes.clouds.column_decoder import decode_column, read_bytes
from lidarcodec.planes.clouds.columns import (
    WITH_PLANE,
    Coded,
    Image,
    columns_of,
    encode_bytes,
    encode_column,
    plane_of,
    put_sized,
)
from lidarcodec.planes.clouds.comparison import same_but_near
from lidarcodec.planes.clouds.positions import Fitted, Positions, decode_positions, encode_positions
from lidarcodec.planes.plane_section import PlaneKind, decode_plane_section, encode_plane_section
from lidarcodec.sensors.clouds.grid import MAX_CELLS as MAX_GRID
from lidarcodec.sensors.clouds.grid import MAX_ROWS, Grid, GridFinder
from lidarcodec.sensors.clouds.message import (
    MAX_MESSAGE,
    MAX_POINTS,
    CloudHead,
    CloudMessage,
    read_head,
    read_message,
    values_at,
)
from lidarcodec.sensors.images import MAX_CELLS, MAX_PLANES, Plane, Unsigned
from lidarcodec.units import MAX_COLUMNS

Numbers = npt.NDArray[np.int64]

PLAIN, ZSTD, COLUMNS = 0, 1, 2
_NO_GRID, _BY_ROW, _BY_COLUMN = 0, 1, 2
MAX_STEP: Final = 65_535
"""Most bytes of a point whose columns are coded apart: what is in no field is a column for each byte."""
MAX_BOUND_UM: Final = 100_000_000
"""Largest bound on the error of a point, in micrometres."""
_XYZ: Final = frozenset("xyz")
_DECODED_AGAIN: Final = 16
_SURELY_LESS: Final = 3
"""A section by columns that is smaller than the payload by this factor is taken without a look at what zstd makes."""


class CloudBefore:
    """What an encoder knows of the message before in a stream: how its points come, and what they were computed from.

    Each message is decoded without any other: the next one is coded as the one before was, if that does as well.
    """

    def __init__(self) -> None:
        self.grids: Final = GridFinder()
        self.fitted: Fitted | None = None
        self.columns: dict[tuple[str, int, str], Coded] = {}
        self.gaps: Coded | None = None
        self._number = 0
        self._sound = True

    def is_decoded(self) -> bool:
        """Whether the next message is decoded as a receiver does it: the first one, each `_DECODED_AGAIN`th, and all
        behind one that did not come back."""
        self._number += 1
        return not self._sound or self._number % _DECODED_AGAIN == 1

    def found(self, *, sound: bool) -> None:
        """Whether a message came back so."""
        self._sound = sound


def encode_cloud(
    payload: bytes, kind: PlaneKind, max_error_m: float | None = None, before: CloudBefore | None = None
) -> bytes:
    """The section of a payload (lidarcodec/sensors/clouds/message.py).

    max_error_m: largest distance of a point from where it was; None or 0: byte for byte
    before: of the stream, which learns from this message

    Raises SectionError for a payload of more than 32 MiB.
    """
    if len(payload) > MAX_MESSAGE:
        raise SectionError(f"a message of {len(payload)} bytes: the limit is {MAX_MESSAGE}")
    if kind == PlaneKind.PLAIN:
        return bytes([PLAIN]) + payload
    coded: bytes | None = None
    bound, before = max_error_m or None, before or CloudBefore()
    try:
        with np.errstate(all="ignore"):
            coded, known = _in_columns(read_message(payload), kind, bound, before)
            if not _comes_back(coded, payload, known, bound, before):
                coded = None
    except (LidarCodecError, ArithmeticError, ValueError, IndexError):  # numbers that no driver sends
        coded = None
    if coded is not None and len(coded) * _SURELY_LESS <= len(payload):
        return coded
    whole = bytearray([ZSTD])
    put_varint(whole, len(payload))
    whole += compress(payload, 3)
    return coded if coded is not None and len(coded) < len(whole) else bytes(whole)


def _comes_back(coded: bytes, payload: bytes, known: _Known, bound: float | None, before: CloudBefore) -> bool:
    """Whether a section decodes to its payload, or within the bound. Most messages of a stream are decoded but for
    their image and coordinates."""
    if not before.is_decoded():
        return _from_columns(VarintReader(coded[1:]), known).payload == payload
    before.found(sound=False)  # unless it decodes
    back = decode_cloud(coded).payload
    sound = back == payload if bound is None else same_but_near(payload, back, bound)
    before.found(sound=sound)
    return sound


class Cloud(NamedTuple):
    """A decoded section: the payload, and the range image of its points if the section has one."""

    payload: bytes
    grid: Grid | None = None


def bound_of_cloud(data: bytes) -> float:
    """Largest distance in metres of a point from where it was; 0: the message is as it was.

    Raises SectionError or TruncatedError.
    """
    reader = VarintReader(data)
    return reader.varint(MAX_BOUND_UM) * 1e-6 if reader.byte() == COLUMNS else 0.0


def decode_cloud(data: bytes) -> Cloud:
    """The message of a section.

    Raises SectionError or TruncatedError.
    """
    reader = VarintReader(data)
    kind = reader.byte()
    if kind == PLAIN:
        return Cloud(reader.rest(MAX_MESSAGE))
    if kind == ZSTD:
        size = reader.varint(MAX_MESSAGE)
        return Cloud(decompress(reader.rest(len(reader)), size))
    if kind != COLUMNS:
        raise SectionError(f"a cloud of the unknown kind {kind}")
    with np.errstate(all="ignore"):
        return _from_columns(reader)


class _Known(NamedTuple):
    """What an encoder that looks whether all comes back knows: the range image, planes of (N,) numbers by name, and
    coordinates as they were. What comes back of these is known when they are coded (native/src/clouds)."""

    grid: Grid | None
    planes: dict[str, npt.NDArray[np.uint32]]
    positions: Positions | None


def _in_columns(
    message: CloudMessage, kind: PlaneKind, max_error_m: float | None, before: CloudBefore
) -> tuple[bytes, _Known]:
    """The section, and what is in it."""
    head = message.head
    if not 0 < head.points <= MAX_POINTS or head.point_step > MAX_STEP:
        raise SectionError(f"a message of {head.points} points of {head.point_step} bytes has no columns")
    level = 3 if kind == PlaneKind.ZSTD else 9
    out = bytearray([COLUMNS])
    put_varint(out, math.ceil((max_error_m or 0.0) * 1e6))
    _put_packed(out, message.payload[: head.size], level)
    _put_packed(out, message.between.tobytes(), level)
    _put_packed(out, message.tail, level)
    grid = before.grids.find(message)
    positions = None
    if grid is not None and not _shares_bytes(head):
        positions = encode_positions(message, grid, max_error_m, level, before.fitted)
    before.fitted = None if positions is None else positions.fitted
    nothing = np.zeros(head.points, np.int64)
    image = positions.image if positions is not None else Image(grid, None, nothing, nothing, level)
    columns, gaps = columns_of(head, _XYZ if positions is not None else frozenset())
    coded = [encode_column(_values(message, at, dtype), image, before.columns.get((name, at, dtype)))
             for name, at, dtype in columns]  # fmt: skip
    before.columns = dict(zip(columns, coded, strict=True))
    _put_grid(out, grid)
    out.append(int(positions is not None))
    planes: dict[str, Numbers] = {}
    if grid is not None:
        planes["range"] = np.ones(head.points, np.int64) if positions is None else positions.image.n.astype(np.int64)
        for number, one in enumerate(coded):
            if one.plane is not None and len(planes) >= _most_planes(grid):
                coded[number] = encode_column(
                    _values(message, *columns[number][1:]), Image(None, None, nothing, nothing)
                )
            elif one.plane is not None:
                planes[f"c{number}"] = one.plane
        _put_planes(out, planes, grid, kind)
    if positions is not None:
        put_sized(out, positions.data)
    for one in coded:
        out.append(one.way)
        out += one.data
    if len(gaps):
        before.gaps = encode_bytes(np.ascontiguousarray(message.points[:, gaps]), level, before.gaps)
        out += before.gaps.data
    return bytes(out), _Known(grid, {name: part.astype(np.uint32) for name, part in planes.items()}, positions)


def _shares_bytes(head: CloudHead) -> bool:
    """Whether x, y or z lies over another field, so that the one cannot be coded without the other."""
    fields = np.zeros(head.point_step, np.int64)
    for one in head.fields:
        fields[one.offset : one.offset + np.dtype(one.kind).itemsize * one.repeated] += 1
    axes = [head.by_name[name] for name in "xyz" if name in head.by_name]
    return any((fields[one.offset : one.offset + np.dtype(one.kind).itemsize] > 1).any() for one in axes)


def _from_columns(reader: VarintReader, known: _Known | None = None) -> Cloud:
    """The message of a section behind its kind. known: of an encoder that looks whether all else comes back."""
    reader.varint(MAX_BOUND_UM)
    around = _read_around(reader)
    head, points = around.head, around.head.points
    if head.point_step > MAX_STEP:
        raise SectionError(f"a cloud by columns with points of {head.point_step} bytes: the limit is {MAX_STEP}")
    kind = reader.byte()
    grid_head = _read_grid_head(reader, kind, points)
    positioned = reader.byte()
    if positioned > 1 or (positioned and kind == _NO_GRID):
        raise SectionError("coordinates by a range image that is not there")
    found: dict[str, npt.NDArray[np.uint32]] = {}
    grid: Grid | None = None
    if grid_head is not None:
        coded = reader.take(reader.varint(len(reader)))
        if known is None:
            grid, found = _at_points(grid_head, _read_planes(coded, grid_head), points)
        else:
            grid, found = _as_known(grid_head, known, points), known.planes
    fields: list[tuple[int, object]] = []
    nothing = np.zeros(points, np.int64)
    image = Image(grid, None, nothing, nothing)
    if positioned and grid is not None:
        data = reader.take(reader.varint(len(reader)))
        if known is None or known.positions is None:
            xyz, image = decode_positions(data, grid, found["range"])
        else:
            xyz, image = known.positions.xyz, known.positions.image
        for name, values in zip("xyz", xyz, strict=True):
            axis = head.by_name.get(name)
            if axis is None or axis.kind != "f4":
                raise SectionError(f"coordinates in a cloud without a float32 {name}")
            fields.append((axis.offset, values))
    columns, gaps = columns_of(head, _XYZ if positioned else frozenset())
    for number, (_, at, dtype) in enumerate(columns):
        way = reader.byte()
        plane = found.get(f"c{number}")
        if way in WITH_PLANE and plane is None:
            raise SectionError(f"column {number} of a cloud without its plane")
        fields.append((at, decode_column(way, reader, np.dtype(dtype), points, image, plane)))
    if len(gaps):
        others = read_bytes(reader, points, len(gaps)).T
        fields += zip(gaps.tolist(), map(np.ascontiguousarray, others), strict=True)
    reader.end()
    return Cloud(around.message(fields), grid)


class _Around(NamedTuple):
    """What a message has around its points: the bytes before them, behind each row of them, and behind all."""

    before: bytes
    head: CloudHead
    between: bytes
    tail: bytes

    def message(self, fields: list[tuple[int, object]]) -> bytes:
        """The message with these points: the first byte of each field, and its values, (N,)."""
        head, whole = self.head, not self.between
        ends = (self.before, self.tail) if whole else (b"", b"")
        points = _native.message_of_points(*ends, head.points, head.point_step, head.big_endian, fields)
        if whole:
            return points
        rows, padding = (np.frombuffer(part, np.uint8).reshape(head.height, -1) for part in (points, self.between))
        return self.before + np.concatenate((rows, padding), axis=1).tobytes() + self.tail


def _read_around(reader: VarintReader) -> _Around:
    before = _read_packed(reader, MAX_MESSAGE)
    head = read_head(before)
    if head.size != len(before) or not head.regular or head.size + head.data_bytes > MAX_MESSAGE:
        raise SectionError("the header of a cloud is not valid, or does not fit its points")
    points = head.points
    if not 0 < points <= MAX_POINTS or points * head.point_step > head.data_bytes:
        raise SectionError(f"a cloud of {points} points in {head.data_bytes} bytes")
    between = _read_packed(reader, head.data_bytes - points * head.point_step)
    tail = _read_packed(reader, MAX_MESSAGE - head.size - head.data_bytes)
    if len(between) != head.data_bytes - points * head.point_step:
        raise SectionError("rows of a cloud that are not as long as their step")
    return _Around(before, head, between, tail)


def _values(message: CloudMessage, at: int, kind: str) -> npt.NDArray[Any]:
    """(N,) values in the machine's byte order."""
    return values_at(message.points, at, np.dtype(kind).newbyteorder(">" if message.head.big_endian else "<"))


def _put_packed(out: bytearray, data: bytes, level: int) -> None:
    put_varint(out, len(data))
    if data:
        packed = compress(data, level)
        put_varint(out, len(packed))
        out += packed


def _read_packed(reader: VarintReader, most: int) -> bytes:
    size = reader.varint(most)
    return decompress(reader.take(reader.varint(len(reader))), size) if size else b""


def _put_grid(out: bytearray, grid: Grid | None) -> None:
    if grid is None:
        out.append(_NO_GRID)
        return
    out.append(_BY_COLUMN if grid.by_column else _BY_ROW)
    out.append(grid.rows - 1)
    put_varint(out, grid.columns)
    out.append(int(grid.full))
    if grid.by_column:
        out += bytes(grid.firing.astype(np.uint8))


def _read_grid_head(reader: VarintReader, kind: int, points: int) -> Grid | None:
    """A grid without the places of its points; None if there is none."""
    if kind == _NO_GRID:
        return None
    if kind > _BY_COLUMN:
        raise SectionError(f"a range image of the unknown kind {kind}")
    rows, columns, full = reader.byte() + 1, reader.varint(MAX_COLUMNS, least=1), reader.byte()
    if rows > MAX_ROWS or full > 1 or rows * columns > MAX_GRID or rows * columns < points or not points:
        raise SectionError(f"a range image of {rows} x {columns} for {points} points")
    firing = np.arange(rows)
    if kind == _BY_COLUMN:
        firing = np.frombuffer(reader.take(rows), np.uint8).astype(np.int64)
        if not np.array_equal(np.sort(firing), np.arange(rows)):
            raise SectionError("the order of firing is damaged")
    none = np.zeros(0, np.int64)
    return Grid(rows, columns, none, none, kind == _BY_COLUMN, firing, full == 1, "")


def _at_points(head: Grid, planes: dict[str, Unsigned], points: int) -> tuple[Grid, dict[str, npt.NDArray[np.uint32]]]:
    """The grid with the places of its points, and the numbers of planes at the points."""
    images: list[object] = list(planes.values())
    order = head.rows, head.columns, head.by_column, head.firing
    row, column, numbers = _native.points_of_images(order, head.full, images)
    if len(row) != points:
        raise SectionError(f"a range image of {len(row)} points, not {points}")
    return replace(head, row=row, column=column), dict(zip(planes, numbers, strict=True))


def _as_known(head: Grid, known: _Known, points: int) -> Grid:
    """The grid that a decoder finds. Raises SectionError unless it is the one that is known."""
    assert known.grid is not None
    found, _ = _at_points(head, {"range": known.grid.mask().view(np.uint8)}, points)
    if not np.array_equal(found.row, known.grid.row) or not np.array_equal(found.column, known.grid.column):
        raise SectionError("points that do not come in the order of their range image")
    return found


def _most_planes(grid: Grid) -> int:
    return min(MAX_PLANES, MAX_CELLS // (grid.rows * grid.columns))


def _put_planes(out: bytearray, planes: dict[str, Numbers], grid: Grid, kind: PlaneKind) -> None:
    forms: list[Plane] = []
    images: dict[str, Unsigned] = {}
    for name, numbers in planes.items():
        form, images[name] = plane_of(name, numbers, grid, "range" if name == "range" else "attribute")
        forms.append(form)
    put_sized(out, encode_plane_section(kind, forms, images, np.zeros(grid.rows, np.int32), 1))


def _read_planes(coded: bytes, grid: Grid) -> dict[str, Unsigned]:
    planes = decode_plane_section(coded, grid.columns)
    if planes["range"].shape != (grid.rows, grid.columns):
        raise SectionError(f"planes of {planes['range'].shape} of a cloud of {grid.rows} x {grid.columns}")
    return planes
