"""The mask: a cell that comes back wrong is a ghost point or a lost one, so it is exact on anything."""

from __future__ import annotations

import doctest
from contextlib import suppress
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarcodec.entropy import columns_in_turn, decode_mask, encode_mask, mask_coder
from lidarcodec.entropy.mask_coder import row_geometry
from lidarcodec.errors import DecodeError, SectionError, TruncatedError
from lidarcodec.sensor_model import Calibration, SensorModel
from tests.entropy.frames import all_fired, frames, mask, one_in_three, sensor
from tests.reference import mask as reference_mask
from tests.sweeps import examples

GOLDEN = Path(__file__).parent.parent / "golden"
SENSOR = sensor()


def golden_case() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A mask, what fired, and an earlier mask, from arithmetic alone."""
    row, column = np.mgrid[0:64, 0:60]
    wave = (row * 7 + column * column // 9 + column * row // 13) % 23
    fired = np.array([np.ones(60), np.arange(60) % 3 > 0], np.bool_)
    return (wave > 3) & fired[(row >= 32).astype(int), column], fired, np.roll(wave > 3, 2, axis=1)[:, :50]


def golden_sensor() -> SensorModel:
    table = np.zeros((11, 64), np.int32)
    table[0] = np.arange(64) % 5 * 4_000_000 - 300_000_000  # rotation
    table[1] = -np.arange(64) * 500_000  # elevation: rows are lasers
    return SensorModel("HDL-64E", Calibration(table))


@st.composite
def cases(draw: st.DrawFn):
    """Mask, fired, earlier mask or none, sensor."""
    width, seed = draw(st.integers(0, 40)), draw(st.integers(0, 2**32))
    rng = np.random.default_rng(seed)
    fired = rng.random((2, width)) < draw(st.sampled_from([0.0, 0.4, 1.0]))
    sensor_drawn = sensor(seed) if draw(st.booleans()) else SensorModel("HDL-64E", random_calibration(rng))
    half, _ = row_geometry(sensor_drawn)
    density = draw(st.sampled_from([0.0, 0.07, 0.5, 0.85, 1.0]))
    cells = (rng.random((64, width)) < density) & fired[half]
    earlier = rng.random((64, draw(st.integers(0, 50)))) < 0.8 if draw(st.booleans()) else None
    return cells, fired, earlier, sensor_drawn


def random_calibration(rng: np.random.Generator) -> Calibration:
    """Any table: halves mixed in any order of rows, rotation corrections of several turns."""
    return Calibration(rng.integers(-(2**31), 2**31, (11, 64)).astype(np.int32))


def layout_of(fired: np.ndarray, of: SensorModel) -> reference_mask.Layout:
    return reference_mask.Layout(fired.view(np.uint8), *row_geometry(of))


@settings(max_examples=examples(60), deadline=None)
@given(cases())
def test_any_mask_comes_back_and_native_writes_what_the_reference_writes(case):
    cells, fired, earlier, of = case
    data = encode_mask(cells, fired, of, earlier)
    np.testing.assert_array_equal(decode_mask(data, fired, of, earlier), cells)

    layout = layout_of(fired, of)
    before = None if earlier is None or earlier.shape[1] == 0 else earlier.view(np.uint8)
    np.testing.assert_array_equal(reference_mask.decode_mask(data, layout, before), cells)
    if len(data) > 1:
        turn, shift = int.from_bytes(data[1:3], "little"), int.from_bytes(data[3:5], "little", signed=True)
        before, shift = (before, shift) if data[0] == reference_mask.WITH_EARLIER else (None, 0)
        assert data == reference_mask.encode_mask(cells.view(np.uint8), layout, turn, shift, before)


@pytest.mark.parametrize("width", [1, 2, 7, 174, 2088])
@pytest.mark.parametrize("fired_of", [all_fired, one_in_three])
def test_patchy_masks_of_all_sizes(width, fired_of):
    fired = fired_of(width)
    cells = mask(width) & fired[row_geometry(SENSOR)[0]]
    for earlier in (None, mask(width + 3, seed=2)):
        data = encode_mask(cells, fired, SENSOR, earlier)
        np.testing.assert_array_equal(decode_mask(data, fired, SENSOR, earlier), cells)


@pytest.mark.parametrize("width", [0, 1, 2088, 24576])
def test_all_and_none_cost_a_byte(width):
    fired = one_in_three(width)
    for cells in (np.zeros((64, width), np.bool_), fired[row_geometry(SENSOR)[0]]):
        data = encode_mask(cells, fired, SENSOR)
        assert len(data) == 1
        np.testing.assert_array_equal(decode_mask(data, fired, SENSOR), cells)


def test_one_lonely_return_costs_a_few_bytes():
    cells = np.zeros((64, 2088), np.bool_)
    cells[20, 1000] = True
    assert len(encode_mask(cells, all_fired(2088), SENSOR)) < 60


def test_the_widest_frame():
    cells = mask(24576)
    data = encode_mask(cells, all_fired(24576), SENSOR)
    np.testing.assert_array_equal(decode_mask(data, all_fired(24576), SENSOR), cells)


def test_a_sparse_keep_mask_costs_little_more_than_its_entropy():
    cells = np.random.default_rng(4).random((64, 2088)) < 0.07
    entropy = -0.07 * np.log2(0.07) - 0.93 * np.log2(0.93)
    assert len(encode_mask(cells, all_fired(2088), SENSOR)) * 8 < 1.04 * entropy * cells.size


def test_alignment_pays_on_rows_that_see_the_same_at_other_columns():
    scene = mask(3000, seed=5)[:1].repeat(64, axis=0)
    behind = SENSOR.calibration["rot_correction_rad"][SENSOR.laser_of_ring] % (2 * np.pi) - np.pi
    shift = np.rint(behind / (2 * np.pi) * 2154).astype(int)
    cells = np.stack([scene[0, 400 - s : 2400 - s] for s in shift])
    aligned = encode_mask(cells, all_fired(2000), SENSOR)
    plain = encode_mask(cells, all_fired(2000), SensorModel("HDL-64E", Calibration.from_values({})))
    assert len(aligned) < len(plain) / 3
    assert abs(int.from_bytes(aligned[1:3], "little") - 2154) < 110


def test_a_cell_where_nothing_fired_is_refused():
    cells = np.zeros((64, 5), np.bool_)
    cells[40, 1] = True
    with pytest.raises(SectionError, match="did not fire"):
        encode_mask(cells, one_in_three(5), SENSOR)


@pytest.mark.parametrize(
    ("cells", "fired", "earlier"),
    [
        (np.zeros((64, 4), np.bool_), np.zeros((2, 5), np.bool_), None),
        (np.zeros((63, 4), np.bool_), np.zeros((2, 4), np.bool_), None),
        (np.zeros((64, 4), np.uint8), np.zeros((2, 4), np.bool_), None),
        (np.zeros((64, 4), np.bool_), np.zeros((3, 4), np.bool_), None),
        (np.zeros((64, 4), np.bool_), np.zeros(4, np.bool_), None),
        (np.zeros((64, 4), np.bool_), np.zeros((2, 4), np.bool_), np.zeros((4, 64), np.bool_)),
        (np.zeros((64, 30000), np.bool_), np.zeros((2, 30000), np.bool_), None),
    ],
)
def test_arrays_of_the_wrong_shape_are_refused(cells, fired, earlier):
    with pytest.raises(SectionError):
        encode_mask(cells, fired, SENSOR, earlier)


def test_strided_arrays_are_taken_as_they_read():
    cells, fired = mask(80)[:, ::2], all_fired(80)[:, ::2]
    data = encode_mask(cells, fired, SENSOR, mask(90)[:, ::3])
    np.testing.assert_array_equal(decode_mask(data, fired, SENSOR, mask(90)[:, ::3]), cells)


def test_a_mask_that_needs_an_earlier_one_says_so():
    cells = mask(50)
    with pytest.raises(SectionError, match="earlier"):
        decode_mask(encode_mask(cells, all_fired(50), SENSOR, cells), all_fired(50), SENSOR)


@settings(max_examples=examples(300), deadline=None)
@given(st.binary(max_size=60), st.integers(0, 30), st.sampled_from([None, mask(9)]), st.integers(0, 4))
def test_any_bytes_give_a_mask_or_an_error_of_the_tree(data, width, earlier, kind):
    data = bytes([kind]) + data
    fired = one_in_three(width)
    try:
        cells = decode_mask(data, fired, SENSOR, earlier)
    except (SectionError, TruncatedError):
        return
    assert cells.shape == (64, width)
    assert not cells[~fired[row_geometry(SENSOR)[0]]].any()


def test_no_cut_passes_for_the_whole_and_flips_never_crash():
    cells, fired = mask(120), all_fired(120)
    data = encode_mask(cells, fired, SENSOR)
    for cut in range(len(data)):
        with suppress(DecodeError):
            assert not np.array_equal(decode_mask(data[:cut], fired, SENSOR), cells)
    for at in range(8 * len(data)):
        damaged = bytearray(data)
        damaged[at // 8] ^= 1 << at % 8
        with suppress(DecodeError):
            assert decode_mask(bytes(damaged), fired, SENSOR).shape == (64, 120)


@pytest.mark.parametrize("name", ["entropy_mask_alone", "entropy_mask_with_earlier"])
def test_golden_bytes(name):
    cells, fired, earlier = golden_case()
    golden = (GOLDEN / f"{name}.bin").read_bytes()
    np.testing.assert_array_equal(decode_mask(golden, fired, golden_sensor(), earlier), cells)
    turn, shift = int.from_bytes(golden[1:3], "little"), int.from_bytes(golden[3:5], "little", signed=True)
    before, shift = (earlier.view(np.uint8), shift) if name.endswith("earlier") else (None, 0)
    layout = layout_of(fired, golden_sensor())
    assert reference_mask.encode_mask(cells.view(np.uint8), layout, turn, shift, before) == golden


def test_an_earlier_mask_that_tells_nothing_costs_nothing():
    cells, noise = mask(500), np.random.default_rng(1).random((64, 500)) < 0.5
    assert encode_mask(cells, all_fired(500), SENSOR, noise) == encode_mask(cells, all_fired(500), SENSOR)
    assert encode_mask(cells, all_fired(500), SENSOR, cells)[0] == reference_mask.WITH_EARLIER


def test_real_frames_cost_at_most_a_fifth_of_a_bit_a_point(data_file):
    found = frames(data_file("kitti_sfnd_f000-049.pcap.xz"), data_file("kitti_hdl64e_s2_recovered.yaml"), 4)
    alone, with_earlier, points = 0, 0, 0
    for before, frame in pairwise(found[:4]):
        cells = frame.valid
        data = encode_mask(cells, frame.fired, frame.sensor, turn=columns_in_turn(frame.azimuth))
        np.testing.assert_array_equal(decode_mask(data, frame.fired, frame.sensor), cells)
        alone += 8 * len(data)
        with_earlier += 8 * len(encode_mask(cells, frame.fired, frame.sensor, before.valid))
        points += frame.points
    assert alone / points < 0.20
    assert with_earlier / points < 0.93 * alone / points


def test_the_real_s3_capture(data_file):
    frame, *_ = frames(data_file("hdl64e_s3_atwall.pcap"), data_file("calib_ros_64e_s3-xiesc.yaml"), 1)
    assert 0.3 < frame.fired[1].mean() < 0.4
    data = encode_mask(frame.valid, frame.fired, frame.sensor)
    np.testing.assert_array_equal(decode_mask(data, frame.fired, frame.sensor), frame.valid)
    assert 8 * len(data) / frame.points < 0.30


def test_documentation_example():
    assert doctest.testmod(mask_coder).failed == 0
