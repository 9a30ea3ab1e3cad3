"""The native coder of points and fields against one that was written after the document alone."""

from __future__ import annotations

import numpy as np
import pytest

from lidarcodec import _native
from lidarcodec.errors import DecodeError
from lidarcodec.planes.clouds.columns import zigzag
from lidarcodec.planes.clouds.geometry import SCALES, Geometry, from_ordered, ordered, predicted
from lidarcodec.planes.clouds.section import CloudBefore, decode_cloud, encode_cloud
from lidarcodec.planes.plane_section import PlaneKind
from tests.point_clouds import message, ouster, velodyne
from tests.reference.clouds import Coordinates, Reader, Rests, directions, field_rests, unzigzag

ROWS, COLUMNS = 8, 60


def cells(seed: int, *, by_column: bool) -> tuple[int, int, np.ndarray, np.ndarray]:
    """Cells of about three quarters of an image."""
    there = np.random.default_rng(seed).random((ROWS, COLUMNS)) < 0.75
    row, column = np.nonzero(there)
    if by_column:
        column, row = np.nonzero(there.T)
    return ROWS, COLUMNS, np.ascontiguousarray(row), np.ascontiguousarray(column)


def geometry(seed: int, turn: int, *, narrow: bool, angles: int) -> Geometry:
    rng = np.random.default_rng(seed)
    values = [0.98, 0.02, rng.uniform(-0.3, 0.3, ROWS), 0.05, rng.uniform(-0.02, 0.02, ROWS), rng.uniform(-9, 9, ROWS)]
    scales = SCALES.values()
    rows = [np.rint(np.broadcast_to(value, (ROWS,)) / scale) for value, scale in zip(values, scales, strict=True)]
    return Geometry(0.004, turn, narrow, angles, np.stack(rows).astype(np.int64))


def exponents(values: np.ndarray) -> np.ndarray:
    return values.astype(np.float32).view(np.uint32).astype(np.int64) >> 23 & 0xFF


@pytest.mark.parametrize(("angles", "narrow"), [(0, False), (0, True), (1, False), (4, True), (6, False)])
@pytest.mark.parametrize(("by_column", "turn"), [(True, 36000), (True, 1024), (False, 36000), (False, 1 << 24)])
def test_points_are_read_as_the_document_says(angles: int, narrow: bool, by_column: bool, turn: int) -> None:
    given, rng = cells(angles, by_column=by_column), np.random.default_rng(angles + turn)
    model = geometry(angles, turn, narrow=narrow, angles=angles)
    _, _, row, column = given
    points = len(row)
    n = rng.integers(300, 20_000, points).astype(np.uint32)
    k = np.mod(column * (turn // COLUMNS) + 3 * row + rng.integers(-1, 2, points), turn) - turn // 2
    told = np.stack(predicted(model, row, n, k)).astype(np.float32)
    xyz = from_ordered(ordered(told) + rng.integers(-3, 4, told.shape) ** 3)
    returned = np.ones(points, np.uint8)
    native = model.native(0, 1.0)
    data, states, coded_n, coded_k, _, _ = _native.encode_points(
        xyz, returned, given, native, n, k.astype(np.int32), None, 0.0, False
    )
    assert not states.any()
    np.testing.assert_array_equal(coded_n, n)
    found, found_k = _native.decode_points(data, given, native, n)
    np.testing.assert_array_equal(found.view(np.uint32), xyz.view(np.uint32))

    reader = Reader(data)
    form = reader.take(1)[0]
    step = unzigzag(reader.varint()) if form else None
    order = list(zip(row.tolist(), column.tolist(), strict=True))
    expected = directions(Rests(reader.sized()), order, turn, step)
    assert expected == coded_k.tolist() == found_k.tolist()
    float_ = np.float32 if narrow else np.float64
    rho = n.astype(float_) * float_(model.step_m) * model.value("along")[row].astype(float_)
    far = exponents(rho + model.value("along_m")[row].astype(float_))
    told = np.stack(predicted(model, row, n, np.array(expected)))
    for axis in range(3):
        rests, near = Coordinates(Rests(reader.sized())), exponents(told[axis])
        left = [rests.next(r, int(a), int(b)) for (r, _), a, b in zip(order, near, far, strict=True)]
        assert rests.rests.used_up()
        np.testing.assert_array_equal(ordered(told[axis].astype(np.float32)) + left, ordered(xyz[axis]))


@pytest.mark.parametrize("most", [0, 1, 15, 16, 300, (1 << 28) - 1])
def test_rests_of_fields_are_read_as_the_document_says(most: int) -> None:
    given, rng = cells(most % 97, by_column=bool(most % 2)), np.random.default_rng(most)
    rests = (rng.integers(0, most, len(given[2]), endpoint=True) * (rng.random(len(given[2])) < 0.5)).astype(np.uint32)
    data = _native.encode_field_rests(given, rests)
    assert field_rests(data, list(zip(given[2].tolist(), given[3].tolist(), strict=True))) == rests.tolist()
    np.testing.assert_array_equal(_native.decode_field_rests(data, given), rests)
    for damaged in (data[:-1], data + b"\0"):
        with pytest.raises(DecodeError):
            _native.decode_field_rests(damaged, given)


def test_sums_come_back_and_say_of_how_many_points_something_is_left() -> None:
    given = cells(3, by_column=True)
    by_row, left = np.arange(ROWS) * 10, np.zeros(len(given[2]), np.int64)
    left[[7, 50]] = (-4, 2)
    numbers = 1000 * given[3] + by_row[given[2]] + left
    by_column, coded, not_told = _native.encode_sums(given, numbers, by_row)
    assert not_told <= len(numbers) // 8
    np.testing.assert_array_equal(_native.decode_sums(coded, given, by_column, by_row), numbers)
    assert zigzag(np.array([-4, 2])).tolist() == [7, 4]


def drive() -> list[bytes]:
    """Messages of a sensor, then of another, and of the first again."""
    return [*(message(velodyne(seed=seed)) for seed in range(4)), message(ouster(), 16), message(velodyne(seed=9))]


@pytest.mark.parametrize("bound_m", [None, 0.02])
def test_a_message_is_coded_as_well_after_others_as_alone(bound_m: float | None) -> None:
    before = CloudBefore()
    for payload in drive():
        coded = encode_cloud(payload, PlaneKind.QUICK, bound_m, before)
        if bound_m is None:
            assert decode_cloud(coded).payload == payload
        assert len(coded) <= 1.02 * len(encode_cloud(payload, PlaneKind.QUICK, bound_m))
