"""Columns: the fields of all points of a cloud, beside x, y and z. Each is coded in the way that needs fewest bytes.

 0 bytes      the lowest bytes of all numbers, then the next ones, ..., less those of the point before; zstd
 1 constant   one number
 2 row        the row of the range image
 3 range      the range n of the point
 4 metres     n times the range step, as float32
 5 plane      a plane of the image
 6 whole      a plane, its numbers as float32
 7 by row     one number for each row
 8 sums       a number for each column, one for each row, and what is left
 9 times      the same in units of 1e-9, as float32, and what is left in units in the last place
10 angle      the direction of the point in radians, as float32, and what is left as of 9
11 steps      differences to the point before, as numbers of the range coder
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from lidarcodec import _native
from lidarcodec.entropy import fast
from lidarcodec.entropy.rest_coder import put_line
from lidarcodec.entropy.varint import put_varint
from lidarcodec.entropy.zstd_frames import compress
from lidarcodec.planes.clouds.geometry import ANGLES, Geometry, Numbers, directions, ordered
from lidarcodec.sensors.clouds.grid import Grid
from lidarcodec.sensors.clouds.message import CloudHead
from lidarcodec.sensors.images import Plane, Unsigned

Values = npt.NDArray[Any]

MOST: Final = (1 << 20) - 1
"""Largest number in a plane."""
TICK: Final = 1e-9
_TURN: Final = 6.283185307179586
WIDEST: Final = 1 << 60
_MAX_REPEATED: Final = 16
_MORE: Final = (1.25, 0.02)
"""Sums are those of the message before if at most so many times as many points differ from them, and so many more."""
_LONGER: Final = 1.1
"""A column is coded byte by byte, as that of the message before was, if it is at most so many times as long."""
_SURELY_LESS: Final = 4
"""A column in the image of less than a byte for so many points is taken without a look at what zstd makes of it."""
_ANGLE_NUMBERS: Final = range(1, len(ANGLES))


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


WITH_PLANE: Final = frozenset({Way.PLANE, Way.WHOLE})


@dataclass(frozen=True, eq=False)
class Image:
    """What columns can refer to: the grid of the points, their geometry and, a number a point, range n and direction k.

    k is 0 where it means nothing. level: of zstd
    """

    grid: Grid | None
    geometry: Geometry | None
    n: npt.NDArray[np.integer]
    k: npt.NDArray[np.integer]
    level: int = 3


@dataclass(eq=False)
class Coded:
    """A coded column: its bytes, and (N,) numbers of its plane, if it has one.

    For the column of the next message: by_row and left, of SUMS and TIMES, are the numbers of rows and the part of the
    points that differ from the sum; number is the form of ANGLE or BYTES.
    """

    way: Way
    data: bytearray = field(default_factory=bytearray)
    plane: Numbers | None = None
    by_row: Numbers | None = None
    left: float = 0.0
    number: int = 0


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
    found: Numbers = (values << 1) ^ (values >> 63)
    return found


def unzigzag(values: npt.NDArray[np.integer]) -> Numbers:
    """The inverse."""
    wide = values.astype(np.int64)
    found: Numbers = (wide >> 1) ^ -(wide & 1)
    return found


def plane_of(name: str, numbers: Numbers, grid: Grid, role: str = "attribute") -> tuple[Plane, Unsigned]:
    """A plane of numbers, one a point, 0 in cells without one."""
    bits = max(1, int(numbers.max(initial=0)).bit_length())
    form = Plane(name, bits, "range" if role == "range" else "attribute")
    image = grid.image(numbers.astype(form.dtype))
    return form, image.astype(form.dtype)


def put_sized(out: bytearray, data: bytes) -> None:
    """Bytes with their number in front."""
    put_varint(out, len(data))
    out += data


def _put_bytes(out: bytearray, rows: npt.NDArray[np.uint8], level: int, forms: Sequence[int] = (1, 0)) -> int:
    """(N, size) bytes, as of way 0, in that of some forms that takes fewest; the form."""
    packed = []
    for form in forms:
        steps = rows.copy()
        if form:
            steps[1:] -= rows[:-1]
        packed.append(compress(steps.T.tobytes(), level))
    best = min(range(len(forms)), key=lambda number: len(packed[number]))
    out.append(forms[best])
    put_sized(out, packed[best])
    return forms[best]


def numbers_of(values: Values) -> Numbers | None:
    """Values of a column as whole numbers; of float32 in their order. Of 8 bytes their bits less those of the first
    point; None if these differ by 2^60 or more."""
    if values.dtype == np.float32:
        return ordered(values)
    if values.dtype.itemsize < 8:
        return values.astype(np.int64)
    bits = values.view(np.int64)
    steps: Numbers = bits - bits[:1]
    return steps if int(steps.min(initial=0)) > -WIDEST and int(steps.max(initial=0)) < WIDEST else None


def encode_column(values: Values, image: Image, before: Coded | None = None) -> Coded:
    """A column, (N,) in the machine's byte order. before: the same column of the message before it in a stream."""
    raw = np.ascontiguousarray(values).view(np.uint8).reshape(len(values), -1)
    bits = values.view(f"u{values.dtype.itemsize}")
    if len(values) and (bits == bits[0]).all():
        return Coded(Way.CONSTANT, bytearray(raw[0].tobytes()))
    if before is not None and before.way == Way.BYTES:
        again = _bytes_as_before(raw, image.level, before)
        if again is not None:
            return again
    numbers = numbers_of(values)
    found: list[Coded] = []
    if numbers is not None and image.grid is not None:
        in_image = _in_image(values, numbers, image, image.grid, before)
        if in_image is not None:
            found.append(_based(in_image, raw))
            if len(in_image.data) * _SURELY_LESS < len(values):
                return in_image
    found.append(_bytes(raw, image.level))
    if numbers is not None:
        steps = Coded(Way.STEPS)
        put_sized(steps.data, fast.encode_signed((np.diff(numbers, prepend=0),)))
        found.append(_based(steps, raw))
    return min(found, key=lambda one: len(one.data))


def encode_bytes(raw: npt.NDArray[np.uint8], level: int, before: Coded | None = None) -> Coded:
    """(N, size) bytes of points as of way 0. before: the same of the message before it in a stream."""
    again = None if before is None else _bytes_as_before(raw, level, before)
    return _bytes(raw, level) if again is None else again


def _bytes_as_before(raw: npt.NDArray[np.uint8], level: int, before: Coded) -> Coded | None:
    again = _bytes(raw, level, (before.number,))
    return again if len(again.data) <= len(before.data) * _LONGER else None


def _bytes(raw: npt.NDArray[np.uint8], level: int, forms: Sequence[int] = (1, 0)) -> Coded:
    coded = Coded(Way.BYTES)
    coded.number = _put_bytes(coded.data, raw, level, forms)
    return coded


def _based(coded: Coded, raw: npt.NDArray[np.uint8]) -> Coded:
    """With the first point's bits in front, for numbers of 8 bytes."""
    if raw.shape[1] == 8:
        coded.data[:0] = raw[0].tobytes()
    return coded


def _in_image(values: Values, numbers: Numbers, image: Image, grid: Grid, before: Coded | None) -> Coded | None:
    single, long = values.dtype == np.float32, values.dtype.itemsize == 8
    if before is not None:
        found = _as_before(values, numbers, image, grid, before)
        if found is not None:
            return found
    if not long and np.array_equal(numbers, grid.row):
        return Coded(Way.ROW)
    if not long and values.dtype.kind == "u" and np.array_equal(numbers, image.n):
        return Coded(Way.RANGE)
    if single and image.geometry is not None and _same_bits(values, metres_of(image)):
        return Coded(Way.METRES)
    by_row = _first_of(grid.row, grid.rows, numbers)
    if np.array_equal(by_row[grid.row], numbers):
        coded = Coded(Way.BY_ROW)
        put_line(coded.data, by_row)
        return coded
    if single:
        return _whole(values) or _angle(values, image, grid) or _times(values, grid)
    sums = _sums(numbers, grid)
    if not long and _fits_plane(numbers) and (sums is None or int(numbers.max()) < 256):
        return Coded(Way.PLANE, plane=numbers)
    return sums


def _as_before(values: Values, numbers: Numbers, image: Image, grid: Grid, before: Coded) -> Coded | None:
    """A column in the way of the message before, in ways that take long to find; None if that does not do as well."""
    single = values.dtype == np.float32
    if before.way == Way.WHOLE and single:
        return _whole(values)
    if before.way == Way.PLANE and values.dtype.itemsize < 8 and not single and _fits_plane(numbers):
        return Coded(Way.PLANE, plane=numbers)
    if before.way == Way.ANGLE and single and image.geometry is not None:
        found = _angle(values, image, grid, (before.number,))
        return found if found is not None and found.left <= before.left * _MORE[0] + _MORE[1] else None
    if before.by_row is None or len(before.by_row) != grid.rows or single != (before.way == Way.TIMES):
        return None
    found = _times(values, grid, before.by_row) if single else _sums(numbers, grid, before.by_row)
    return found if found is not None and found.left <= before.left * _MORE[0] + _MORE[1] else None


def _fits_plane(numbers: Numbers) -> bool:
    return int(numbers.min()) >= 0 and int(numbers.max()) <= MOST


def _whole(values: Values) -> Coded | None:
    with np.errstate(invalid="ignore", over="ignore"):
        whole = np.where(np.abs(values) <= MOST, values, 0).astype(np.int64)
    if whole.min() < 0 or not _same_bits(values, whole.astype(np.float32)):
        return None
    return Coded(Way.WHOLE, plane=whole)


def _same_bits(one: Values, other: Values) -> bool:
    return np.array_equal(one.view(np.uint32), other.view(np.uint32))


def metres_of(image: Image) -> Values:
    assert image.geometry is not None
    return image.n.astype(np.float32) * np.float32(image.geometry.step_m)


def _first_of(group: Numbers, groups: int, numbers: Numbers) -> Numbers:
    """(groups,) number of the first point of each group; of a group without points that of the one before."""
    found = np.zeros(groups, np.int64)
    there = np.zeros(groups, np.int64)
    begins = np.flatnonzero(np.diff(group, prepend=-1))[::-1]  # of runs of one group, the last run first
    found[group[begins]] = numbers[begins]
    there[group[begins]] = group[begins]
    return found[np.maximum.accumulate(there)]


def _row_numbers(numbers: Numbers, grid: Grid) -> Numbers:
    """(H,) of each row, what its points mostly have more than others of their column."""
    by_column = _first_of(grid.column, grid.columns, numbers)
    by_row = _typical(numbers - by_column[grid.column], grid)
    by_column = _first_of(grid.column, grid.columns, numbers - by_row[grid.row])
    by_row += _typical(numbers - by_row[grid.row] - by_column[grid.column], grid)
    return by_row


def _typical(numbers: Numbers, grid: Grid) -> Numbers:
    """(H,) median of each row."""
    order = np.lexsort((numbers, grid.row))
    count = np.bincount(grid.row, minlength=grid.rows)
    begin = np.concatenate(([0], np.cumsum(count)[:-1]))
    found: Numbers = np.where(count > 0, numbers[order][np.minimum(begin + count // 2, len(numbers) - 1)], 0)
    return found


def _sums(numbers: Numbers, grid: Grid, by_row: Numbers | None = None) -> Coded | None:
    """by_row: of the message before; None: it is found."""
    if max(abs(int(numbers.min())), abs(int(numbers.max()))) >= WIDEST:
        return None
    by_row = _row_numbers(numbers, grid) if by_row is None else by_row
    return _summed(Way.SUMS, _native.encode_sums(grid.cells, numbers, by_row), by_row, len(numbers))


def _times(values: Values, grid: Grid, by_row: Numbers | None = None) -> Coded | None:
    if by_row is None:
        with np.errstate(invalid="ignore", over="ignore"):
            ticks = np.rint(values.astype(np.float64) / TICK)
        if not np.all(np.abs(ticks) < 1e15):
            return None
        by_row = _row_numbers(ticks.astype(np.int64), grid)
    return _summed(Way.TIMES, _native.encode_times(grid.cells, values, by_row), by_row, len(values))


def _summed(way: Way, sums: tuple[Numbers, bytes, int] | None, by_row: Numbers, points: int) -> Coded | None:
    if sums is None or max(int(np.abs(part).max()) for part in (sums[0], by_row)) >= WIDEST:
        return None
    by_column, left, not_told = sums
    coded = Coded(way, by_row=by_row, left=not_told / points)
    put_line(coded.data, by_column)
    put_line(coded.data, by_row)
    put_sized(coded.data, left)
    return coded


def angles_of(image: Image, grid: Grid, number: int) -> npt.NDArray[np.float32]:
    """Direction of each point in radians as the driver has it with sense and quarters of ANGLES[number]."""
    assert image.geometry is not None
    sense, quarters = ANGLES[number]
    turns = directions(image.geometry, grid.row, image.k.astype(np.int64)) * sense + quarters * 0.25
    return ((turns - np.floor(turns)) * _TURN).astype(np.float32)


def _angle(values: Values, image: Image, grid: Grid, numbers: Sequence[int] = _ANGLE_NUMBERS) -> Coded | None:
    if image.geometry is None:
        return None
    best: Numbers | None = None
    least, number = np.inf, 0
    for one in numbers:
        left = ordered(values) - ordered(angles_of(image, grid, one))
        far = float(np.abs(left).mean())
        if int(zigzag(left).max()) <= MOST and far < least:
            least, number, best = far, one, left
    if best is None:
        return None
    coded = Coded(Way.ANGLE, bytearray([number]), left=float(np.count_nonzero(best)) / len(best), number=number)
    put_sized(coded.data, _native.encode_field_rests(grid.cells, zigzag(best).astype(np.uint32)))
    return coded
