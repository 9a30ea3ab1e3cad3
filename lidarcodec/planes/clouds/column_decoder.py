"""Columns of a cloud, decoded: the inverse of columns.py."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from lidarcodec import _native
from lidarcodec.entropy import fast
from lidarcodec.entropy.rest_coder import read_line
from lidarcodec.entropy.varint import VarintReader
from lidarcodec.entropy.zstd_frames import decompress
from lidarcodec.errors import SectionError
from lidarcodec.planes.clouds.columns import WIDEST, Image, Values, Way, angles_of, metres_of, unzigzag
from lidarcodec.planes.clouds.geometry import ANGLES, Numbers, from_ordered, ordered
from lidarcodec.sensors.clouds.grid import Grid


def decode_column(
    way: int,
    reader: VarintReader,
    dtype: np.dtype[Any],
    points: int,
    image: Image,
    plane: npt.NDArray[np.uint32] | None,
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
        return from_numbers(image.n.astype(np.int64), dtype)
    if way == Way.BY_ROW:
        return from_numbers(read_line(reader, grid.rows)[grid.row] + base, dtype)
    if way == Way.SUMS:
        by_column, by_row = _read_sums(reader, grid)
        return from_numbers(_native.decode_sums(_left(reader), grid.cells, by_column, by_row) + base, dtype)
    if way == Way.PLANE and plane is not None:
        return from_numbers(plane.astype(np.int64), dtype)
    if dtype != np.float32:
        raise SectionError(f"a column of {dtype} coded in the way {way}")
    if way == Way.WHOLE and plane is not None:
        return plane.astype(np.float32)
    if way == Way.TIMES:
        by_column, by_row = _read_sums(reader, grid)
        times: Values = _native.decode_times(_left(reader), grid.cells, by_column, by_row)
        return times
    if image.geometry is not None and way == Way.METRES:
        return metres_of(image)
    if image.geometry is not None and way == Way.ANGLE:
        number = reader.byte()
        if not 1 <= number < len(ANGLES):
            raise SectionError(f"an angle of the unknown sense {number}")
        left = unzigzag(_native.decode_field_rests(_left(reader), grid.cells))
        return from_numbers(ordered(angles_of(image, grid, number)) + left, dtype)
    raise SectionError(f"a column coded in the unknown way {way}")


def _left(reader: VarintReader) -> bytes:
    return reader.take(reader.varint(len(reader)))


def _read_sums(reader: VarintReader, grid: Grid) -> tuple[Numbers, Numbers]:
    """The numbers of columns, (W,), and of rows, (H,)."""
    by_column, by_row = read_line(reader, grid.columns), read_line(reader, grid.rows)
    if any(int(part.min(initial=0)) <= -WIDEST or int(part.max(initial=0)) >= WIDEST for part in (by_column, by_row)):
        raise SectionError("a number of a column or row beyond 60 bits")
    return by_column, by_row


def read_bytes(reader: VarintReader, points: int, size: int) -> npt.NDArray[np.uint8]:
    """The inverse: (N, size)."""
    differences = reader.byte()
    if differences > 1:
        raise SectionError(f"bytes of the unknown form {differences}")
    plain = decompress(reader.take(reader.varint(len(reader))), points * size)
    rows = np.frombuffer(plain, np.uint8).reshape(size, points).T
    found: npt.NDArray[np.uint8] = np.add.accumulate(rows, axis=0, dtype=np.uint8) if differences else rows
    return found


def from_numbers(numbers: Numbers, dtype: np.dtype[Any]) -> Values:
    """The inverse. Raises SectionError for a number that does not fit."""
    if dtype.itemsize == 8:
        return numbers.view(dtype)
    limits = np.iinfo(np.int32 if dtype == np.float32 else dtype)
    if len(numbers) and not limits.min <= int(numbers.min()) <= int(numbers.max()) <= limits.max:
        raise SectionError(f"a number that does not fit a column of {dtype}")
    return from_ordered(numbers) if dtype == np.float32 else numbers.astype(dtype)
