"""x, y and z of the points of a cloud: range n, direction k, and what is left of each coordinate.

Ranges are a plane of the range image. The native core (native/src/clouds) codes the rest. A point whose coordinates are
not what the geometry says, by more than that can code, is *apart*: its bytes are sent.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec import _native
from lidarcodec.entropy import fast
from lidarcodec.entropy.varint import VarintReader, put_varint
from lidarcodec.entropy.zstd_frames import compress, decompress
from lidarcodec.errors import SectionError
from lidarcodec.planes.clouds.columns import MOST, Image, put_sized
from lidarcodec.planes.clouds.fit import Fit, fit
from lidarcodec.planes.clouds.geometry import ANGLES, SCALES, Geometry, Numbers, ordered, predicted
from lidarcodec.sensors.clouds.grid import Grid
from lidarcodec.sensors.clouds.message import CloudMessage
from lidarcodec.units import AZIMUTH_TURN

Singles = npt.NDArray[np.float32]
Flags = npt.NDArray[np.bool_]

_HEAD: Final = struct.Struct("<BdIBBd")
_DECIMALS: Final = (100.0, 1000.0, 10000.0)
_STEPS_M: Final = (0.008, 0.005, 0.004, 0.0025, 0.002, 0.001)
_LOOKED_AT: Final = 4096
_PART: Final = 0.4
"""Part of the allowed error that a range step may take, and that a direction may."""
_MOST_APART: Final = 0.25
"""Part of the points that may be apart; with more, coordinates are columns."""
_WORSE: Final = 1.02
"""A fit is made anew where a point takes so many times the bits that it took when the fit was made, and more."""
_MORE_BITS: Final = 0.05
_FARTHEST_TURNED: Final = float(1 << 32)


class Left(IntEnum):
    """What is left of a coordinate: units in the last place, steps of 1 / unit, or steps of unit metres."""

    LAST_PLACES = 0
    DECIMALS = 1
    METRES = 2


class State(IntEnum):
    """How a point is coded: by its numbers, by its bytes, or as one without a return, whose bits are known."""

    CODED = 0
    APART = 1
    EMPTY = 2


@dataclass(frozen=True, eq=False)
class Positions:
    """x, y and z as they are coded. data: all but the ranges, which `image` has; xyz: (3, N) before they were coded."""

    data: bytes
    image: Image
    xyz: Singles
    fitted: Fitted


@dataclass(frozen=True, eq=False)
class Fitted:
    """What coordinates are computed from, for the message after this one too.

    bits: that a point took, roughly, when the fit was made; apart: part of the points that were apart
    step_m: of ranges that the message has beside its coordinates; None if it has none
    bound_m: of the error; useless: how many times in a row a new fit was no better
    by_column: whether directions are told well by columns
    """

    geometry: Geometry
    left: Left
    unit: float
    bits: float
    apart: float
    step_m: float | None
    bound_m: float | None
    useless: int = 0
    by_column: bool = False


class _Coded(NamedTuple):
    data: bytes
    states: npt.NDArray[np.uint8]
    n: npt.NDArray[np.uint32]
    k: npt.NDArray[np.int32]
    bits: float
    by_column: bool

    @property
    def apart(self) -> float:
        """Part of the points that are apart."""
        return float(np.count_nonzero(self.states == State.APART)) / max(len(self.states), 1)


class _Known(NamedTuple):
    """Ranges that a message has beside its coordinates, (N,), 0 where there is none, and their step in metres."""

    n: npt.NDArray[np.uint32]
    step_m: float


def encode_positions(
    message: CloudMessage, grid: Grid, max_error_m: float | None, level: int, before: Fitted | None = None
) -> Positions | None:
    """A message's float32 coordinates; None if these are of another type, or do not lie as rows of beams do.

    max_error_m: largest distance between a point and what comes back; None: every bit comes back
    before: of the message before it in a stream
    """
    axes = [message.values(name) for name in "xyz"]
    if any(axis is None or axis.dtype != np.float32 for axis in axes):
        return None
    xyz = np.stack([np.asarray(axis) for axis in axes])
    there = message.returns
    if np.count_nonzero(there) < 16:
        return None
    none = _none_of(xyz, there) if grid.full else None
    known = _known(message, there, None if before is None else before.step_m)

    def coded(fitted: Fitted) -> _Coded:
        n = None if known is None else known.n
        native, bound_m = fitted.geometry.native(fitted.left, fitted.unit), max_error_m or 0.0
        returned = there.view(np.uint8)
        return _Coded(
            *_native.encode_points(xyz, returned, grid.cells, native, n, None, none, bound_m, fitted.by_column)
        )

    found: _Coded | None = None
    kept = before if before is not None and _fits(before, grid, known, max_error_m) else None
    if kept is not None:
        found = coded(kept)
        patience = 1 << min(kept.useless, 6)
        worst = kept.bits * (1 + (_WORSE - 1) * patience) + _MORE_BITS * patience
        if found.bits <= worst and found.apart <= kept.apart + 0.01 * patience:
            return _positions(found, xyz, grid, kept, none, level)
    fresh = _fitted(message, grid, xyz[:, there].astype(np.float64), known, max_error_m)
    other = coded(fresh)
    if kept is None or found is None or other.bits + 32 * other.apart < found.bits + 32 * found.apart:
        found, kept = other, replace(fresh, bits=other.bits, apart=other.apart, by_column=other.by_column)
    else:
        kept = replace(kept, bits=found.bits, apart=found.apart, useless=kept.useless + 1)
    return None if found.apart > _MOST_APART else _positions(found, xyz, grid, kept, none, level)


def _positions(
    found: _Coded, xyz: Singles, grid: Grid, fitted: Fitted, none: npt.NDArray[np.uint32] | None, level: int
) -> Positions:
    out = bytearray()
    _put_geometry(out, fitted)
    put_sized(out, found.data)
    _put_apart(out, xyz, found.states == State.APART, none, level)
    image = Image(grid, fitted.geometry, found.n, found.k, level)
    return Positions(bytes(out), image, xyz, fitted)


def decode_positions(data: bytes, grid: Grid, ranges: npt.NDArray[np.uint32]) -> tuple[Singles, Image]:
    """(3, N) float32 coordinates, and what columns need of them. ranges: (N,) n of each point.

    Raises SectionError, TruncatedError.
    """
    reader = VarintReader(data)
    geometry, left, unit = _read_geometry(reader, grid.rows)
    coded = reader.take(reader.varint(len(reader)))
    xyz, k = _native.decode_points(coded, grid.cells, geometry.native(left, unit), ranges)
    places, values, none = _read_apart(reader, len(ranges))
    reader.end()
    if none is not None:
        xyz[:, ranges == 0] = none[:, None].view(np.float32)
    xyz[:, places] = values
    return xyz, Image(grid, geometry, ranges, k)


def _fits(before: Fitted, grid: Grid, known: _Known | None, max_error_m: float | None) -> bool:
    """Whether what was found in the message before can be true of this one."""
    step_m = None if known is None else known.step_m
    rows = before.geometry.rows.shape[1]
    return rows == grid.rows and before.step_m == step_m and before.bound_m == max_error_m


def _none_of(xyz: Singles, returns: Flags) -> npt.NDArray[np.uint32] | None:
    """(3,) bits of most points without a return."""
    bits = xyz.view(np.uint32)[:, ~returns]
    if not bits.shape[1]:
        return None
    first = bits[:, 0].copy()
    if (bits == first[:, None]).all():
        return first
    kinds, counts = np.unique(bits, axis=1, return_counts=True)
    found: npt.NDArray[np.uint32] = kinds[:, counts.argmax()].copy()
    return found


def _known(message: CloudMessage, there: Flags, step_m: float | None) -> _Known | None:
    """Ranges that the message has beside its coordinates: Ouster's `range` or nebula's `distance`. step_m: of the
    message before."""
    ranges = message.values("range")
    if ranges is not None and ranges.dtype.kind == "u" and 0 < int(ranges[there].max()) <= MOST:
        return _Known(np.where(there, ranges, 0).astype(np.uint32), 0.001)
    distances = message.values("distance")
    if distances is None or distances.dtype != np.float32:
        return None
    found = distances[there]
    for step in sorted(_STEPS_M, key=lambda step: (step != step_m, -step)):
        with np.errstate(invalid="ignore", over="ignore"):
            n = np.rint(np.clip(found / np.float32(step), 0, MOST)).astype(np.uint32)
        if np.array_equal(n.astype(np.float32) * np.float32(step), found) and n.min() > 0:
            whole = np.zeros(len(there), np.uint32)
            whole[there] = n
            return _Known(whole, step)
    return None


def _fitted(
    message: CloudMessage, grid: Grid, xyz: npt.NDArray[np.float64], known: _Known | None, max_error_m: float | None
) -> Fitted:
    """A fit to the points with a return, (3, N)."""
    there = message.returns
    row, column = grid.row[there], grid.column[there]
    decimal = next((unit for unit in _DECIMALS if _is_decimal(xyz, unit)), None)
    step_m: float | None = None
    fine: int | None = None
    if max_error_m is not None:
        left, unit = Left.METRES, max_error_m * (2 / np.sqrt(3)) * 0.98
        step_m = None if known else 2 * _PART * max_error_m
        far = float(np.percentile(np.hypot(xyz[0], xyz[1]), 50))
        fine = 1 << int(np.clip(np.ceil(np.log2(max(np.pi * far / (_PART * max_error_m), 1.0))), 10, 24))
    elif decimal is not None:
        left, unit = Left.DECIMALS, decimal
        step_m, fine = (None, None) if known else (1.0 / decimal, AZIMUTH_TURN)
    else:
        left, unit = Left.LAST_PLACES, 1.0
    known_n, known_step_m = (None, None) if known is None else (known.n[there].astype(np.int64), known.step_m)
    found = fit(
        xyz, row, column, grid.rows, known=known_n, known_step_m=known_step_m or 0.0, step_m=step_m, fine_turn=fine
    )
    geometry = found.geometry if left != Left.LAST_PLACES else _rounded_as_driver(found, xyz, row)
    return Fitted(geometry, left, float(unit), np.inf, 1.0, known_step_m, max_error_m)


def _is_decimal(xyz: npt.NDArray[np.float64], unit: float) -> bool:
    """Whether all coordinates are whole numbers divided by this one, as float32."""
    for part in (xyz[:, :256], xyz):
        if not np.array_equal((np.rint(part * unit) / unit).astype(np.float32), part.astype(np.float32)):
            return False
    return True


def _rounded_as_driver(found: Fit, xyz: npt.NDArray[np.float64], row: Numbers) -> Geometry:
    """The geometry with the rounding of the driver, as far as some of the points tell."""
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
    return best


def _put_geometry(out: bytearray, fitted: Fitted) -> None:
    geometry = fitted.geometry
    flags = int(geometry.narrow)
    out += _HEAD.pack(flags, geometry.step_m, geometry.turn, geometry.angles, fitted.left, fitted.unit)
    put_sized(out, fast.encode_signed(list(geometry.rows)))


def _read_geometry(reader: VarintReader, rows: int) -> tuple[Geometry, Left, float]:
    narrow, step_m, turn, angles, left, unit = _HEAD.unpack(reader.take(_HEAD.size))
    sound = narrow <= 1 and angles < len(ANGLES) and left <= Left.METRES and 1 <= turn <= 1 << 28
    if not sound or not 1e-9 < step_m < 1e3 or not 1e-9 < unit < 1e6:
        raise SectionError(f"a geometry of {turn} steps of a turn and ranges in {step_m} m")
    values = fast.decode_signed(reader.take(reader.varint(len(reader))), [rows] * len(SCALES))
    geometry = Geometry(step_m, turn, bool(narrow), angles, np.stack(values))
    if np.abs(geometry.value("turned")).max(initial=0.0) >= _FARTHEST_TURNED:
        raise SectionError("a row that is turned by more than any sensor's")
    return geometry, Left(left), unit


def _put_apart(out: bytearray, xyz: Singles, apart: Flags, none: npt.NDArray[np.uint32] | None, level: int) -> None:
    out.append(int(none is not None))
    if none is not None:
        out += none.astype("<u4").tobytes()
    places = np.flatnonzero(apart)
    put_varint(out, len(places))
    if not len(places):
        return
    put_sized(out, fast.encode_signed((np.diff(places, prepend=-1) - 1,)))
    put_sized(out, compress(xyz[:, places].astype("<f4").tobytes(), level))


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
