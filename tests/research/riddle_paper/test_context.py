"""If these fail, the network is shown what a decoder does not have yet, or the scan before in the wrong place."""

from __future__ import annotations

import numpy as np
import pytest

from lidarcodec.errors import LidarCodecError
from lidarcodec.frame import Frame
from lidarcodec.motion.motion import STILL, Motion
from research.riddle_paper.context import OFFSETS, SPATIAL, ContextReader, nearest_anchor
from research.riddle_paper.images import PaperImage, image_of, ranges_of
from research.riddle_paper.moved import MovedPoints
from tests.research.riddle_paper.scenes import toy_frame, toy_ranges, toy_sensor


def test_the_patch_is_what_is_before_a_cell_in_ten_rows_and_ten_columns() -> None:
    assert len(OFFSETS) == SPATIAL == 99
    assert len({tuple(place) for place in OFFSETS.tolist()}) == 99
    assert OFFSETS.min() == -9
    assert OFFSETS.max() == 0
    assert (0, 0) not in OFFSETS.tolist()
    assert OFFSETS[:3].tolist() == [[0, -1], [0, -2], [-1, 0]]  # the nearest anchor is the first


def test_a_context_never_sees_the_cell_itself_or_one_behind_it() -> None:
    image = PaperImage.plain(toy_ranges(2, 14, 30), 10)
    rng = np.random.default_rng(1)
    everywhere = np.arange(14 * 30).reshape(14, 30)
    for _ in range(30):
        row, column = int(rng.integers(14)), int(rng.integers(30))
        changed = np.where((everywhere >= row * 30 + column) & image.valid, image.cells + 321, image.cells)
        here = np.array([row]), np.array([column])
        one, other = ContextReader(image).read(*here), ContextReader(image.with_cells(changed)).read(*here)
        assert np.array_equal(one.features, other.features)
        assert np.array_equal(one.anchors_m, other.anchors_m)
        assert np.array_equal(one.before_m, other.before_m)


def test_a_context_says_which_neighbours_are_there() -> None:
    image = PaperImage.plain(toy_ranges(2, 14, 30), 10)
    rows, columns = np.nonzero(image.valid)
    contexts = ContextReader(image).read(rows, columns)
    for cell in range(0, len(rows), 37):
        for number, (down, right) in enumerate(OFFSETS.tolist()):
            r, c = rows[cell] + down, columns[cell] + right
            there = r >= 0 and c >= 0 and bool(image.valid[r, c])
            assert contexts.valid[cell, number] == there
            if there:
                assert np.isclose(contexts.anchors_m[cell, number], image.cells[r, c] * image.step_m, atol=1e-4)
    assert np.isfinite(contexts.features).all()
    assert not contexts.features[~contexts.valid][:, :6].any()


def test_of_equal_anchors_the_nearest_is_right() -> None:
    image = PaperImage.plain(np.full((12, 12), 7.0), 10)
    context = ContextReader(image).read(np.array([11]), np.array([11]))
    anchor, there = nearest_anchor(context, np.array([7.0], np.float32))
    assert (anchor[0], there[0]) == (0, True)


def scan(step: int = 10) -> tuple[PaperImage, np.ndarray, Frame]:
    ranges = (toy_ranges(4, 64, 300).clip(0, 100) * 500).astype(np.uint16)
    frame = toy_frame(ranges, first=9000)
    image = image_of(frame, step)
    return image, ranges_of(image, frame), frame


def test_a_sensor_that_stands_finds_its_own_returns_again() -> None:
    image, sent, frame = scan()
    rows, columns = np.nonzero(image.valid)
    rows, columns = rows[::17], columns[::17]
    true = image.cells[rows, columns].astype(np.float32) * np.float32(image.step_m)
    seen = MovedPoints(frame, sent, STILL, count=20).nearest(rows, image.azimuth[rows, columns], true)
    assert seen.valid.all()
    own = np.abs(seen.ranges_m[:, 0] - true) < 0.005
    assert own.mean() > 0.99  # its own point, at its own range: offsets and corrections of the beams are undone
    assert np.abs(seen.azimuth[own, 0]).max() < 1e-4
    apart = np.hypot(seen.azimuth * np.cos(image.elevation[rows, columns])[:, None], seen.elevation)
    assert np.diff(apart, axis=1).min() > -5e-4  # nearest first, but for the roundness of the sphere


def test_what_lies_ahead_is_nearer_once_the_sensor_has_driven_there() -> None:
    sensor = toy_sensor()
    native = (11.0 - sensor.calibration["dist_correction_m"][sensor.laser_of_ring]) / 0.002
    ranges = np.rint(np.broadcast_to(native[:, None], (64, 120))).astype(np.uint16)
    frame = toy_frame(ranges, first=8000)  # 11 m in all beams, around azimuth 90 degrees
    image = image_of(frame, 10)
    rows, columns = np.nonzero(image.valid & (np.abs(image.azimuth - np.pi / 2) < 0.1) & (image.elevation > -0.1))
    true = image.cells[rows, columns].astype(np.float32) * np.float32(image.step_m)
    driven = Motion(shift=(0, 16_000, 0))  # the sensor drove a metre to its right, where it looks at 90 degrees
    seen = MovedPoints(frame, ranges_of(image, frame), driven, count=5).nearest(
        rows, image.azimuth[rows, columns], true
    )
    nearer = true[:, None] - seen.ranges_m
    assert 0.95 < nearer.min() < nearer.max() < 1.05


def test_a_scan_without_returns_gives_no_neighbours() -> None:
    image, sent, frame = scan()
    rows, columns = np.nonzero(image.valid)
    some = rows[:5], columns[:5]
    empty = MovedPoints(frame, np.zeros_like(sent), STILL, count=7)
    context = ContextReader(image, empty).read(*some)
    assert context.valid.shape == (5, 99 + 7)
    assert not context.valid[:, 99:].any()
    with pytest.raises(LidarCodecError, match="at least 1"):
        MovedPoints(frame, sent, STILL, count=0)
    few = np.zeros_like(sent)
    few[30, 100:103] = 5000
    context = ContextReader(image, MovedPoints(frame, few, STILL, count=7)).read(*some)
    assert context.valid[:, 99:].sum(axis=1).tolist() == [3] * 5
