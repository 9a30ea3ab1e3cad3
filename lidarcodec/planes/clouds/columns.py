"""Columns: the fields of all points of a cloud, beside x, y and z. Each is coded in the way that needs fewest bytes.

 0 bytes      the lowest bytes of all numbers, then the next ones, ..., less those of the point before; zstd
 1 constant   one number
 2 row        the row of the range image
 3 range      the range n of the point
 4 metres     n times the range step, as float32
 5 plane      a plane of the image
 6 whole      a plane, its numbers as float32
 7 by row     one number for each row
 8 sums       a number for each column, one for each row, and the rest as a plane
 9 times      the same in units of 1e-9, as float32, and the rest as a plane in units in the last place
10 angle      the direction of the point in radians, as float32, the rest as of 9
11 steps      differences to the point before, as numbers of the range coder
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from lidarcodec.entropy import fast
from lidarcodec.entropy.rest_coder import put_line, read_line
from lidarcodec.entropy.varint import VarintReader, put_varint
from lidarcodec.entropy.zstd_frames import compress, decompress
from lidarcodec.errors import SectionError
from lidarcodec.planes.clouds.geometry import ANGLES, Geometry, Numbers, directions, from_ordered, ordered
from lidarcodec.sensors.clouds.grid import Grid
from lidarcodec.sensors.clouds.message import CloudHead
from lidarcodec.sensors.images import Plane, Unsigned

Values = npt.NDArray[Any]

MOST: Final = (1 << 20) - 1
"""Largest number in a plane."""
TICK: Final = 1e-9
_TURN: Final = 6.283185307179586
_WIDEST: Final = 1 << 60
_MAX_REPEATED: Final = 16


class Way(IntEnum):
    """How a column is coded."""

    BYTES = 0
    CONSTANT = 1
    ROW = 2
    RANGE = 3
    METRES = 4
    PLANE = 5
    WHOLE = 6
    BY_ROW = 7
    SUMS = 8
    TIMES = 9
    ANGLE = 10
    STEPS = 11


WITH_PLANE: Final = frozenset({Way.PLANE, Way.WHOLE, Way.SUMS, Way.TIMES, Way.ANGLE})


@dataclass(frozen=True, eq=False)
class Image:
    """What columns can refer to: the grid of the points, their geometry and, a number a point, range n and direction k.

    k is 0 where it means nothing. level: of zstd
    """

    grid: Grid | None
    geometry: Geometry | None
    n: Numbers
    k: Numbers
    level: int = 3


@dataclass(eq=False)
class Coded:
    """A coded column: its bytes, and (N,) numbers of its plane, if it has one."""

    way: Way
    data: bytearray = field(default_factory=bytearray)
    plane: Numbers | None = None


def columns_of(head: CloudHead, besides: frozenset[str]) -> tuple[list[tuple[str, int, str]], npt.NDArray[np.intp]]:
    """The columns of points: name of the field, its first byte, its type (`f4`); and the bytes that are in none.

    besides: fields that are coded in another way. A field that overlaps one before it is in no column.
    """
    free = np.ones(head.point_step, np.bool_)
    found = []
    for one in head.fields:
        size = np.dtype(one.kind).itemsize
        if one.repeated > _MAX_REPEATED:
            continue
        for number in range(one.repeated):
            begin = one.offset + number * size
            if not free[begin : begin + size].all():
                continue
            if one.name not in besides or one.repeated != 1:
                found.append((one.name, begin, one.kind))
            free[begin : begin + size] = False
    return found, np.flatnonzero(free)


def zigzag(values: Numbers) -> Numbers:
    """0, -1, 1, -2 as 0, 1, 2, 3."""
    found: Numbers = np.where(values >= 0, values << 1, (-values << 1) - 1)
    return found


def unzigzag(values: npt.NDArray[np.integer]) -> Numbers:
    """The inverse."""
    wide = values.astype(np.int64)
    found: Numbers = np.where(wide & 1, -((wide + 1) >> 1), wide >> 1)
    return found


def plane_of(name: str, numbers: Numbers, grid: Grid, role: str = "attribute") -> tuple[Plane, Unsigned]:
    """A plane of numbers, one a point, 0 in cells without one."""
    bits = max(1, int(numbers.max(initial=0)).bit_length())
    form = Plane(name, bits, "range" if role == "range" else "attribute")
    image = grid.image(numbers.astype(form.dtype))
    return form, image.astype(form.dtype)


def put_bytes(out: bytearray, rows: npt.NDArray[np.uint8], level: int) -> None:
    """(N, size) bytes, as of way 0."""
    steps = rows.copy()
    steps[1:] -= rows[:-1]
    packed = min((compress(part.T.tobytes(), level) for part in (steps, rows)), key=len)
    out.append(int(len(packed) and packed == compress(steps.T.tobytes(), level)))
    put_varint(out, len(packed))
    out += packed


def read_bytes(reader: VarintReader, points: int, size: int) -> npt.NDArray[np.uint8]:
    """The inverse: (N, size)."""
    differences = reader.byte()
    if differences > 1:
        raise SectionError(f"bytes of the unknown form {differences}")
    plain = decompress(reader.take(reader.varint(len(reader))), points * size)
    rows = np.frombuffer(plain, np.uint8).reshape(size, points).T
    found: npt.NDArray[np.uint8] = np.add.accumulate(rows, axis=0, dtype=np.uint8) if differences else rows
    return found


def numbers_of(values: Values) -> Numbers | None:
    """Values of a column as whole numbers; of float32 in their order. Of 8 bytes their bits less those of the first
    point; None if these differ by 2^60 or more."""
    if values.dtype == np.float32:
        return ordered(values)
    if values.dtype.itemsize < 8:
        return values.astype(np.int64)
    bits = values.view(np.int64)
    steps: Numbers = bits - bits[:1]
    return None if len(steps) and int(np.abs(steps).max()) >= _WIDEST else steps


def from_numbers(numbers: Numbers, dtype: np.dtype[Any]) -> Values:
    """The inverse. Raises SectionError for a number that does not fit."""
    if dtype.itemsize == 8:
        return numbers.view(dtype)
    limits = np.iinfo(np.int32 if dtype == np.float32 else dtype)
    if len(numbers) and not limits.min <= int(numbers.min()) <= int(numbers.max()) <= limits.max:
        raise SectionError(f"a number that does not fit a column of {dtype}")
    return from_ordered(numbers) if dtype == np.float32 else numbers.astype(dtype)


def encode_column(values: Values, image: Image) -> Coded:
    """A column, (N,) in the machine's byte order."""
    raw = np.ascontiguousarray(values).view(np.uint8).reshape(len(values), -1)
    if len(values) and (raw == raw[0]).all():
        return Coded(Way.CONSTANT, bytearray(raw[0].tobytes()))
    numbers = numbers_of(values)
    if numbers is not None and image.grid is not None:
        found = _in_image(values, numbers, image, image.grid)
        if found is not None:
            return _based(found, raw)
    plain = Coded(Way.BYTES)
    put_bytes(plain.data, raw, image.level)
    if numbers is None:
        return plain
    steps = Coded(Way.STEPS)
    coded = fast.encode_signed((np.diff(numbers, prepend=0),))
    put_varint(steps.data, len(coded))
    steps.data += coded
    return min(plain, _based(steps, raw), key=lambda one: len(one.data))


def _based(coded: Coded, raw: npt.NDArray[np.uint8]) -> Coded:
    """With the first point's bits in front, for numbers of 8 bytes."""
    if raw.shape[1] == 8:
        coded.data[:0] = raw[0].tobytes()
    return coded


def _in_image(values: Values, numbers: Numbers, image: Image, grid: Grid) -> Coded | None:
    single, long = values.dtype == np.float32, values.dtype.itemsize == 8
    if not long and np.array_equal(numbers, grid.row):
        return Coded(Way.ROW)
    if not long and values.dtype.kind == "u" and np.array_equal(numbers, image.n):
        return Coded(Way.RANGE)
    if single and image.geometry is not None and _same_bits(values, _metres(image)):
        return Coded(Way.METRES)
    by_row = _first_of(grid.row, grid.rows, numbers)
    if np.array_equal(by_row[grid.row], numbers):
        coded = Coded(Way.BY_ROW)
        put_line(coded.data, by_row)
        return coded
    if single:
        with np.errstate(invalid="ignore", over="ignore"):
            whole = np.where(np.abs(values) <= MOST, values, 0).astype(np.int64)
        if whole.min() >= 0 and _same_bits(values, whole.astype(np.float32)):
            return Coded(Way.WHOLE, plane=whole)
        return _angle(values, image, grid) or _times(values, grid)
    sums = _sums(numbers, grid)
    if (
        not long
        and int(numbers.min()) >= 0
        and int(numbers.max()) <= MOST
        and (sums is None or int(numbers.max()) < 256)
    ):
        return Coded(Way.PLANE, plane=numbers)
    return sums


def _same_bits(one: Values, other: Values) -> bool:
    return np.array_equal(one.view(np.uint32), other.view(np.uint32))


def _metres(image: Image) -> Values:
    assert image.geometry is not None
    return image.n.astype(np.float32) * np.float32(image.geometry.step_m)


def _first_of(group: Numbers, groups: int, numbers: Numbers) -> Numbers:
    """(groups,) number of the first point of each group; of a group without points that of the one before."""
    found = np.zeros(groups, np.int64)
    there = np.zeros(groups, np.int64)
    found[group[::-1]] = numbers[::-1]
    there[group] = np.arange(groups)[group]
    return found[np.maximum.accumulate(there)]


def _split_up(numbers: Numbers, grid: Grid) -> tuple[Numbers, Numbers, Numbers]:
    """A number for each column, (W,), one for each row, (H,), and what is left of each point."""
    by_column = _first_of(grid.column, grid.columns, numbers)
    by_row = _typical(numbers - by_column[grid.column], grid)
    by_column = _first_of(grid.column, grid.columns, numbers - by_row[grid.row])
    by_row += _typical(numbers - by_row[grid.row] - by_column[grid.column], grid)
    return by_column, by_row, numbers - by_column[grid.column] - by_row[grid.row]


def _typical(numbers: Numbers, grid: Grid) -> Numbers:
    """(H,) median of each row."""
    order = np.lexsort((numbers, grid.row))
    count = np.bincount(grid.row, minlength=grid.rows)
    begin = np.concatenate(([0], np.cumsum(count)[:-1]))
    found: Numbers = np.where(count > 0, numbers[order][np.minimum(begin + count // 2, len(numbers) - 1)], 0)
    return found


def _sums(numbers: Numbers, grid: Grid) -> Coded | None:
    by_column, by_row, left = _split_up(numbers, grid)
    spread = zigzag(left)
    if int(spread.max()) > MOST or max(int(np.abs(part).max()) for part in (by_column, by_row)) >= _WIDEST:
        return None
    coded = Coded(Way.SUMS, plane=spread)
    put_line(coded.data, by_column)
    put_line(coded.data, by_row)
    return coded


def _times(values: Values, grid: Grid) -> Coded | None:
    with np.errstate(invalid="ignore", over="ignore"):
        ticks = np.rint(values.astype(np.float64) / TICK)
    if not np.all(np.abs(ticks) < 1e15):
        return None
    by_column, by_row, _ = _split_up(ticks.astype(np.int64), grid)
    told = (by_column[grid.column] + by_row[grid.row]).astype(np.float64) * TICK
    spread = zigzag(ordered(values) - ordered(told.astype(np.float32)))
    if int(spread.max()) > MOST:
        return None
    coded = Coded(Way.TIMES, plane=spread)
    put_line(coded.data, by_column)
    put_line(coded.data, by_row)
    return coded


def _angles(image: Image, grid: Grid, number: int) -> npt.NDArray[np.float32]:
    """Direction of each point in radians as the driver has it with sense and quarters of ANGLES[number]."""
    assert image.geometry is not None
    sense, quarters = ANGLES[number]
    turns = directions(image.geometry, grid.row, image.k) * sense + quarters * 0.25
    return ((turns - np.floor(turns)) * _TURN).astype(np.float32)


def _angle(values: Values, image: Image, grid: Grid) -> Coded | None:
    if image.geometry is None:
        return None
    best: Coded | None = None
    least = np.inf
    for number in range(1, len(ANGLES)):
        spread = zigzag(ordered(values) - ordered(_angles(image, grid, number)))
        if int(spread.max()) <= MOST and spread.mean() < least:
            least, best = float(spread.mean()), Coded(Way.ANGLE, bytearray([number]), spread)
    return best


def decode_column(
    way: int, reader: VarintReader, dtype: np.dtype[Any], points: int, image: Image, plane: Numbers | None
) -> Values:
    """The inverse of `encode_column`. plane: (N,) numbers of its plane, if it has one.

    Raises SectionError, TruncatedError.
    """
    grid = image.grid
    if way == Way.BYTES:
        raw = np.ascontiguousarray(read_bytes(reader, points, dtype.itemsize))
        return raw.view(dtype).ravel()
    if way == Way.CONSTANT:
        return np.full(points, np.frombuffer(reader.take(dtype.itemsize), dtype)[0], dtype)
    base = np.int64(0)
    if dtype.itemsize == 8:
        base = np.frombuffer(reader.take(8), "<i8").astype(np.int64)[0]
    if way == Way.STEPS:
        (steps,) = fast.decode_signed(reader.take(reader.varint(len(reader))), [points])
        return from_numbers(np.cumsum(steps) + base, dtype)
    if grid is None:
        raise SectionError(f"a column coded in the way {way}, of a cloud without a range image")
    if dtype.itemsize == 8 and way not in (Way.BY_ROW, Way.SUMS):
        raise SectionError(f"a column of {dtype} coded in the way {way}")
    if way == Way.ROW:
        return from_numbers(grid.row, dtype)
    if way == Way.RANGE:
        return from_numbers(image.n, dtype)
    if way == Way.BY_ROW:
        return from_numbers(read_line(reader, grid.rows)[grid.row] + base, dtype)
    if way == Way.SUMS and plane is not None:
        return from_numbers(_told(reader, grid) + unzigzag(plane) + base, dtype)
    if way == Way.PLANE and plane is not None:
        return from_numbers(plane, dtype)
    if dtype != np.float32:
        raise SectionError(f"a column of {dtype} coded in the way {way}")
    if way == Way.WHOLE and plane is not None:
        return plane.astype(np.float32)
    if way == Way.TIMES and plane is not None:
        told = (_told(reader, grid).astype(np.float64) * TICK).astype(np.float32)
        return from_numbers(ordered(told) + unzigzag(plane), dtype)
    if image.geometry is not None and way == Way.METRES:
        return _metres(image)
    if image.geometry is not None and way == Way.ANGLE and plane is not None:
        number = reader.byte()
        if not 1 <= number < len(ANGLES):
            raise SectionError(f"an angle of the unknown sense {number}")
        return from_numbers(ordered(_angles(image, grid, number)) + unzigzag(plane), dtype)
    raise SectionError(f"a column coded in the unknown way {way}")


def _told(reader: VarintReader, grid: Grid) -> Numbers:
    """(N,) sum of the numbers of column and row."""
    by_column = read_line(reader, grid.columns)
    by_row = read_line(reader, grid.rows)
    if max(int(np.abs(part).max(initial=0)) for part in (by_column, by_row)) >= _WIDEST:
        raise SectionError("a number of a column or row beyond 60 bits")
    told: Numbers = by_column[grid.column] + by_row[grid.row]
    return told
