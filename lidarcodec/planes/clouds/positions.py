"""x, y and z of the points of a cloud as planes: range n, direction k, and what is left of each coordinate.

A point whose coordinates are not what the geometry says, by more than a plane can hold, is *apart*: its bytes are sent.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.entropy import fast
from lidarcodec.entropy.rest_coder import put_line, read_line
from lidarcodec.entropy.varint import VarintReader, put_varint
from lidarcodec.entropy.zstd_frames import compress, decompress
from lidarcodec.errors import SectionError
from lidarcodec.planes.clouds.columns import MOST, Image, unzigzag, zigzag
from lidarcodec.planes.clouds.fit import Fit, fit
from lidarcodec.planes.clouds.geometry import (
    ANGLES,
    SCALES,
    Geometry,
    Numbers,
    from_ordered,
    ordered,
    predicted,
)
from lidarcodec.sensors.clouds.grid import Grid
from lidarcodec.sensors.clouds.message import CloudMessage
from lidarcodec.units import AZIMUTH_TURN

Singles = npt.NDArray[np.float32]

NAMES: Final = ("range", "direction", "x", "y", "z")
_ULPS, _DECIMAL, _METRES = 0, 1, 2
_HEAD: Final = struct.Struct("<BdIBBd")
_DECIMALS: Final = (100.0, 1000.0, 10000.0)
_LOOKED_AT: Final = 4096
_PART: Final = 0.4
"""Part of the allowed error that a range step may take, and that a direction may."""


@dataclass(frozen=True, eq=False)
class Positions:
    """x, y and z as planes and what they need beside: head (bytes), and (N,) numbers of each plane of NAMES."""

    head: bytes
    image: Image
    planes: dict[str, Numbers]


@dataclass(frozen=True, eq=False)
class _Rest:
    """What is left of coordinates. kind: units in the last place, steps of 1 / unit, or steps of unit metres."""

    kind: int
    unit: float

    def of(self, values: Singles, told: npt.NDArray[np.float64], bound_m: float | None) -> Numbers:
        """(3, N) whole numbers. Beyond the range of planes they mean nothing."""
        single = told.astype(np.float32)
        if self.kind == _ULPS:
            return ordered(values) - ordered(single)
        if self.kind == _DECIMAL:
            return _whole(values.astype(np.float64) * self.unit) - _whole(told * self.unit)
        off = values.astype(np.float64) - single
        steps = _whole((values.astype(np.float64) - told) / self.unit)
        near = np.sqrt((off * off).sum(axis=0)) <= (bound_m or 0.0)
        return np.where(near, 0, steps)

    def back(self, told: npt.NDArray[np.float64], rest: Numbers) -> Singles:
        """(3, N) coordinates."""
        if self.kind == _ULPS:
            numbers = np.clip(ordered(told.astype(np.float32)) + rest, -(2**31), 2**31 - 1)
            return from_ordered(numbers)
        if self.kind == _DECIMAL:
            return ((_whole(told * self.unit) + rest).astype(np.float64) / self.unit).astype(np.float32)
        return (told + rest.astype(np.float64) * self.unit).astype(np.float32)


def _whole(values: npt.NDArray[np.float64]) -> Numbers:
    with np.errstate(invalid="ignore"):
        found: Numbers = np.rint(np.clip(values, -1e15, 1e15)).astype(np.int64)
    return found


def encode_positions(message: CloudMessage, grid: Grid, max_error_m: float | None, level: int) -> Positions | None:
    """Planes of a message's float32 coordinates; None if these are of another type, or do not lie as rows of beams do.

    max_error_m: largest distance between a point and what comes back; None: every bit comes back
    """
    axes = [message.values(name) for name in "xyz"]
    if any(axis is None or axis.dtype != np.float32 for axis in axes):
        return None
    xyz = np.stack([np.asarray(axis, np.float32) for axis in axes])
    none = _none_of(xyz, message.returns) if grid.full else None
    empty = np.zeros(grid.row.shape, np.bool_)
    if none is not None:
        empty = (xyz.view(np.uint32) == none[:, None]).all(axis=0) & ~message.returns
    there = message.returns
    if np.count_nonzero(there) < 16:
        return None
    found, rest = _fitted(message, grid, xyz[:, there].astype(np.float64), max_error_m)
    n, k = np.zeros(len(there), np.int64), np.zeros(len(there), np.int64)
    n[there], k[there] = found.n, found.k
    told = np.stack(predicted(found.geometry, grid.row, n, k))
    left = rest.of(xyz, told, max_error_m)
    back = rest.back(told, left)
    spread = zigzag(left)
    by_column = _columns(k, there, grid)
    spread_k = zigzag(k - by_column[grid.column])
    fits = there & (spread <= MOST).all(axis=0) & (spread_k <= MOST)
    if max_error_m is None or rest.kind != _METRES:
        fits &= (back.view(np.uint32) == xyz.view(np.uint32)).all(axis=0)
    else:
        off = back.astype(np.float64) - xyz
        fits &= (off * off).sum(axis=0) <= max_error_m * max_error_m
    apart = ~fits & ~empty
    if np.count_nonzero(apart) > 0.25 * len(there):
        return None
    unused = ~fits
    n = np.where(apart & ~(there & (n > 0)), 1, n)
    n[empty] = 0
    k = np.where(unused, by_column[grid.column], k)
    planes = {"range": n, "direction": np.where(unused, 0, spread_k)}
    planes |= {name: np.where(unused, 0, part) for name, part in zip("xyz", spread, strict=True)}
    out = bytearray()
    _put_geometry(out, found.geometry, rest)
    put_line(out, by_column)
    _put_apart(out, xyz, apart, none, level)
    image = Image(grid, found.geometry, n, k, level)
    return Positions(bytes(out), image, planes)


def decode_positions(reader: VarintReader, grid: Grid, planes: dict[str, Numbers]) -> tuple[Singles, Image]:
    """(3, N) float32 coordinates, and what columns need of them.

    Raises SectionError, TruncatedError.
    """
    geometry, rest = _read_geometry(reader, grid.rows)
    by_column = read_line(reader, grid.columns)
    if int(np.abs(by_column).max(initial=0)) >= 1 << 40:
        raise SectionError("a direction of a column that is no direction")
    n = planes["range"]
    k = by_column[grid.column] + unzigzag(planes["direction"])
    told = np.stack(predicted(geometry, grid.row, n, k))
    left = np.stack([unzigzag(planes[name]) for name in "xyz"])
    with np.errstate(over="ignore", invalid="ignore"):
        xyz = rest.back(told, left)
    places, values, none = _read_apart(reader, len(n))
    if none is not None:
        xyz[:, n == 0] = none[:, None].view(np.float32)
    xyz[:, places] = values
    return xyz, Image(grid, geometry, n, k)


def _none_of(xyz: Singles, returns: npt.NDArray[np.bool_]) -> npt.NDArray[np.uint32] | None:
    """(3,) bits of most points without a return."""
    bits = xyz.view(np.uint32)[:, ~returns]
    if not bits.shape[1]:
        return None
    kinds, counts = np.unique(bits, axis=1, return_counts=True)
    found: npt.NDArray[np.uint32] = kinds[:, counts.argmax()]
    return found


def _known(message: CloudMessage, there: npt.NDArray[np.bool_]) -> tuple[Numbers, float] | None:
    """Ranges that the message has beside its coordinates, and their step: Ouster's `range` or nebula's `distance`."""
    ranges = message.values("range")
    if ranges is not None and ranges.dtype.kind == "u" and 0 < int(ranges[there].max()) <= MOST:
        return ranges[there].astype(np.int64), 0.001
    distances = message.values("distance")
    if distances is None or distances.dtype != np.float32:
        return None
    found = distances[there]
    for step in (0.008, 0.005, 0.004, 0.0025, 0.002, 0.001):
        with np.errstate(invalid="ignore", over="ignore"):
            n = np.rint(np.clip(found / np.float32(step), 0, MOST)).astype(np.int64)
        if np.array_equal(n.astype(np.float32) * np.float32(step), found) and n.min() > 0:
            return n, step
    return None


def _fitted(
    message: CloudMessage, grid: Grid, xyz: npt.NDArray[np.float64], max_error_m: float | None
) -> tuple[Fit, _Rest]:
    there = message.returns
    known = _known(message, there)
    row, column = grid.row[there], grid.column[there]
    decimal = next((unit for unit in _DECIMALS if _is_decimal(xyz, unit)), None)
    step_m: float | None = None
    fine: int | None = None
    if max_error_m is not None:
        rest = _Rest(_METRES, max_error_m * (2 / np.sqrt(3)) * 0.98)
        step_m = None if known else 2 * _PART * max_error_m
        far = float(np.percentile(np.hypot(xyz[0], xyz[1]), 50))
        fine = 1 << int(np.clip(np.ceil(np.log2(max(np.pi * far / (_PART * max_error_m), 1.0))), 10, 24))
    elif decimal is not None:
        rest = _Rest(_DECIMAL, decimal)
        step_m, fine = (None, None) if known else (1.0 / decimal, AZIMUTH_TURN)
    else:
        rest = _Rest(_ULPS, 1.0)
    known_n, known_step_m = known if known is not None else (None, 0.0)
    found = fit(xyz, row, column, grid.rows, known=known_n, known_step_m=known_step_m, step_m=step_m, fine_turn=fine)
    return (found if rest.kind != _ULPS else _rounded_as_driver(found, xyz, row)), rest


def _is_decimal(xyz: npt.NDArray[np.float64], unit: float) -> bool:
    """Whether all coordinates are whole numbers divided by this one, as float32."""
    return bool(np.array_equal((np.rint(xyz * unit) / unit).astype(np.float32), xyz.astype(np.float32)))


def _rounded_as_driver(found: Fit, xyz: npt.NDArray[np.float64], row: Numbers) -> Fit:
    """The same with the rounding of the driver, as far as some of the points tell."""
    chosen = slice(None, None, max(1, len(row) // _LOOKED_AT))
    exact = ordered(xyz[:, chosen].astype(np.float32))
    best, least = found.geometry, np.inf
    for narrow in (False, True):
        for angles in range(len(ANGLES)):
            geometry = replace(found.geometry, narrow=narrow, angles=angles)
            told = np.stack(predicted(geometry, row[chosen], found.n[chosen], found.k[chosen]))
            off = np.abs(ordered(told.astype(np.float32)) - exact)
            cost = float(np.log2(1.0 + off).sum())
            if cost < least:
                best, least = geometry, cost
    return found._replace(geometry=best)


def _columns(k: Numbers, there: npt.NDArray[np.bool_], grid: Grid) -> Numbers:
    """(W,) direction of each column: the median of those of its points; of a column without any that before it."""
    column, directions = grid.column[there], k[there]
    order = np.lexsort((directions, column))
    count = np.bincount(column, minlength=grid.columns)
    begin = np.concatenate(([0], np.cumsum(count)[:-1]))
    middle = directions[order][np.minimum(begin + count // 2, len(directions) - 1)]
    last = np.maximum.accumulate(np.where(count > 0, np.arange(grid.columns), 0))
    found: Numbers = middle[last]
    return found


def _put_geometry(out: bytearray, geometry: Geometry, rest: _Rest) -> None:
    flags = int(geometry.narrow)
    out += _HEAD.pack(flags, geometry.step_m, geometry.turn, geometry.angles, rest.kind, rest.unit)
    coded = fast.encode_signed(list(geometry.rows))
    put_varint(out, len(coded))
    out += coded


def _read_geometry(reader: VarintReader, rows: int) -> tuple[Geometry, _Rest]:
    narrow, step_m, turn, angles, kind, unit = _HEAD.unpack(reader.take(_HEAD.size))
    sound = narrow <= 1 and angles < len(ANGLES) and kind <= _METRES and 1 <= turn <= 1 << 28
    if not sound or not 1e-9 < step_m < 1e3 or not 1e-9 < unit < 1e6:
        raise SectionError(f"a geometry of {turn} steps of a turn and ranges in {step_m} m")
    values = fast.decode_signed(reader.take(reader.varint(len(reader))), [rows] * len(SCALES))
    return Geometry(step_m, turn, bool(narrow), angles, np.stack(values)), _Rest(kind, unit)


def _put_apart(
    out: bytearray,
    xyz: Singles,
    apart: npt.NDArray[np.bool_],
    none: npt.NDArray[np.uint32] | None,
    level: int,
) -> None:
    out.append(int(none is not None))
    if none is not None:
        out += none.astype("<u4").tobytes()
    places = np.flatnonzero(apart)
    put_varint(out, len(places))
    if not len(places):
        return
    coded = fast.encode_signed((np.diff(places, prepend=-1) - 1,))
    put_varint(out, len(coded))
    out += coded
    packed = compress(xyz[:, places].astype("<f4").tobytes(), level)
    put_varint(out, len(packed))
    out += packed


def _read_apart(
    reader: VarintReader, points: int
) -> tuple[npt.NDArray[np.intp], Singles, npt.NDArray[np.uint32] | None]:
    has_none = reader.byte()
    none = np.frombuffer(reader.take(12), "<u4").astype(np.uint32) if has_none == 1 else None
    count = reader.varint(points)
    if has_none > 1:
        raise SectionError("a mark of points without a return that is neither 0 nor 1")
    if not count:
        return np.zeros(0, np.intp), np.zeros((3, 0), np.float32), none
    (steps,) = fast.decode_signed(reader.take(reader.varint(len(reader))), [count])
    if int(steps.min()) < 0 or int(steps.max()) >= points or int(steps.sum()) + count > points:
        raise SectionError("a point apart beyond the points of the cloud")
    plain = decompress(reader.take(reader.varint(len(reader))), 12 * count)
    values = np.frombuffer(plain, "<f4").astype(np.float32).reshape(3, count)
    return np.cumsum(steps + 1) - 1, values, none
