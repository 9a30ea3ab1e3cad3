"""The canvas: laid out and undone exactly, whatever the calibration; bad heads cost an error, not memory."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarcodec.errors import SectionError
from lidarcodec.ranges.image.canvas import MAX_OFFSET, MAX_SPAN, Canvas, level_offsets, spacing_of
from lidarcodec.ranges.image.canvas_head import HEAD, canvas_of_frame, split_canvas
from lidarcodec.sensor_model import Calibration, SensorModel
from tests.contracts import frames
from tests.sweeps import examples


def sensor(**values: object) -> SensorModel:
    elevation = {"vert_correction_rad": np.linspace(0.03, -0.43, 64)}
    return SensorModel("HDL-64E", Calibration.from_values(elevation | values))  # type: ignore[arg-type]


@settings(max_examples=examples(40), deadline=None)
@given(seed=st.integers(0, 10**6), width=st.integers(1, 60), compact=st.booleans(), multiple=st.sampled_from([1, 8]))
def test_what_is_laid_out_comes_back(seed: int, width: int, compact: bool, multiple: int) -> None:
    rng = np.random.default_rng(seed)
    turned = sensor(rot_correction_rad=rng.uniform(-3.2, 3.2, 64) if seed % 2 else rng.uniform(-0.2, 0.2, 64))
    valid = rng.random((64, width)) < rng.random()
    image = np.where(valid, rng.integers(1, 65536, valid.shape), 0).astype(np.uint16)
    spacing = (int(rng.integers(10**6, 10**8)), int(rng.integers(10**6, 10**8)))
    try:
        canvas = Canvas.of(turned, valid, spacing, compact=compact, multiple=multiple)
    except SectionError:
        return
    assert canvas.width % multiple == 0
    assert canvas.width <= width + MAX_SPAN + multiple
    spread = canvas.spread(image)
    assert np.count_nonzero(spread) == np.count_nonzero(image)
    np.testing.assert_array_equal(canvas.gather(spread), image)
    np.testing.assert_array_equal(canvas.gather(canvas.spread(valid)), valid)


def test_a_column_is_one_direction() -> None:
    """A beam whose laser looks five columns to the left of the first sees the same place five columns later."""
    apart = 300_000
    one = sensor(rot_correction_rad=np.arange(64) % 4 * -5 * apart * 1e-8)
    canvas = Canvas.of(one, np.ones((64, 30), np.bool_), (apart, apart))
    place = np.zeros((64, 30), np.uint16)
    place[np.arange(64), 20 - np.arange(64) % 4 * 5] = 1
    assert set(np.nonzero(canvas.spread(place))[1].tolist()) == {20}


def test_corrections_around_half_a_turn_do_not_tear_the_canvas() -> None:
    """The KITTI sensor looks backwards: its corrections lie at both ends of +-180 degrees."""
    rotation = np.where(np.arange(64) % 2, np.pi - 0.01, -np.pi + 0.01)
    canvas = Canvas.of(sensor(rot_correction_rad=rotation), np.ones((64, 9), np.bool_), (300_000, 300_000))
    assert canvas.width == 9 + 7


def test_the_spacing_is_that_of_the_columns_fired() -> None:
    frame = frames.three_to_one(20)
    upper, lower = spacing_of(frame.azimuth, frame.fired, frame.sensor)
    assert lower == pytest.approx(3 * upper, rel=0.15)
    whole = frames.scene(20)
    assert spacing_of(whole.azimuth, whole.fired, whole.sensor) == (296_705, 296_705)  # 0.17 degrees
    single = frames.scene(1)
    assert spacing_of(single.azimuth[:, :1], single.fired[:, :1], single.sensor) == (0, 0)


def test_rows_that_would_spread_too_far_are_left_where_they_are() -> None:
    frame = frames.scene(2).with_(sensor=sensor(rot_correction_rad=np.linspace(-3, 3, 64)))
    head, canvas = canvas_of_frame(frame, frame.valid)
    assert canvas.width == 12
    assert HEAD.unpack(head) == (0, 0, 0)


def test_offsets_bring_rows_to_one_scale() -> None:
    distances = np.arange(64) * 0.004 + 1
    assert level_offsets(sensor(dist_correction_m=distances)).tolist() == list(range(0, 128, 2))
    wild = level_offsets(sensor(dist_correction_m=np.arange(64.0)))
    assert not wild.any(), f"corrections that differ by more than {MAX_OFFSET} steps are none"


@pytest.mark.parametrize("head", [b"", b"\0" * 8, b"\2" + bytes(8), b"\0\1\0\0\0\1\0\0\0", b"\1" + b"\7\0\0\0" * 2])
def test_a_bad_head_is_refused(head: bytes) -> None:
    frame = frames.scene(2)
    with pytest.raises(SectionError):
        split_canvas(head, frame.valid, frame.sensor)


def test_head_and_canvas_agree_on_both_sides() -> None:
    for frame in (frames.scene(7), frames.three_to_one(5)):
        head, sent = canvas_of_frame(frame, frame.valid, 8)
        came, rest = split_canvas(head + b"rest", frame.valid, frame.sensor, 8)
        assert rest == b"rest"
        assert came.width == sent.width
        np.testing.assert_array_equal(came.spread(frame.range), sent.spread(frame.range))
    taken = [len(columns) for columns in sent.columns if columns is not None]
    assert sorted(set(taken)) == [15, 45], "an S3's unfired halves take no room"
