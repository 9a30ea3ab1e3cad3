"""Rotations: packets are only byte-identical if every one comes back, whatever order the sensor sent them in."""

from __future__ import annotations

import doctest
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarcodec.entropy import azimuth_coder, columns_in_turn, decode_azimuth, encode_azimuth
from lidarcodec.errors import DecodeError, SectionError, TruncatedError
from tests.entropy.frames import all_fired, frames, one_in_three
from tests.reference import azimuth as reference_azimuth
from tests.sweeps import examples

GOLDEN = Path(__file__).parent.parent / "golden"


def turning(width: int, step: float = 16.714, seed: int = 0) -> np.ndarray:
    """(W,) uint16 rotations of an even turn, counted in nines as an HDL-64E does."""
    start = int(np.random.default_rng(seed).integers(0, 36000))
    return ((start + np.arange(width) * step) // 9 * 9 % 36000).astype(np.uint16)


def s3(width: int) -> tuple[np.ndarray, np.ndarray]:
    """Rotations and firings of an S3: one lower block, then three upper ones, all at rotations of their own."""
    fired = one_in_three(width)
    blocks = turning(width + int(fired[1].sum()), 11.4)
    lower = np.flatnonzero(fired[1]) + np.arange(int(fired[1].sum()))
    upper = np.setdiff1d(np.arange(len(blocks)), lower)
    azimuth = np.stack([blocks[upper], blocks[upper]])
    azimuth[1, fired[1]] = blocks[lower]
    return azimuth, fired


def golden_case() -> tuple[np.ndarray, np.ndarray]:
    column = np.arange(200)
    upper = ((35000 + column * 117 // 7) // 9 * 9 + (column == 90) * 117 + (column == 150)) % 36000
    fired = np.array([column % 5 > 0, column % 7 > 0], np.bool_) | (column == 0)
    return np.stack([upper, np.where(fired.all(axis=0), (upper + 35991) % 36000, upper)]).astype(np.uint16), fired


@st.composite
def cases(draw: st.DrawFn):
    """Rotations and firings of any kind."""
    width, rng = draw(st.integers(0, 60)), np.random.default_rng(draw(st.integers(0, 2**32)))
    kind = draw(st.sampled_from(["random", "turning", "repeats", "still"]))
    azimuth = np.stack([turning(width, draw(st.floats(0, 400)))] * 2)
    if kind == "random":
        azimuth = rng.integers(0, 36000, (2, width)).astype(np.uint16)
    elif kind == "repeats":
        azimuth = np.stack([azimuth[0], azimuth[0] - azimuth[0] % 5])
    elif kind == "still":
        azimuth = np.full((2, width), draw(st.integers(0, 35999)), np.uint16)
    fired = rng.random((2, width)) < draw(st.sampled_from([0.0, 0.5, 1.0]))
    azimuth[1] = np.where(fired.all(axis=0), azimuth[1], azimuth[0])
    return azimuth, fired


@settings(max_examples=examples(150), deadline=None)
@given(cases())
def test_any_rotations_come_back_and_native_writes_what_the_reference_writes(case):
    azimuth, fired = case
    data = encode_azimuth(azimuth, fired)
    assert data == reference_azimuth.encode_azimuth(azimuth.tolist(), fired.astype(int).tolist())
    for got, expected in zip(decode_azimuth(data, azimuth.shape[1]), case, strict=True):
        np.testing.assert_array_equal(got, expected)
    assert reference_azimuth.decode_azimuth(data, azimuth.shape[1]) == (azimuth.tolist(), fired.astype(int).tolist())


def test_an_s2_costs_a_tenth_of_a_byte_a_column():
    azimuth = np.stack([turning(2088)] * 2)
    assert len(encode_azimuth(azimuth, all_fired(2088))) < 100


def test_a_sensor_that_stands_still_costs_a_few_bytes():
    assert len(encode_azimuth(np.full((2, 2088), 12345, np.uint16), all_fired(2088))) < 12


def test_the_firing_pattern_of_an_s3_costs_a_few_bytes():
    azimuth = np.full((2, 2088), 12345, np.uint16)
    plain = len(encode_azimuth(azimuth, all_fired(2088)))
    assert len(encode_azimuth(azimuth, one_in_three(2088))) < plain + 12


def test_the_blocks_of_an_s3_come_back():
    azimuth, fired = s3(918)
    data = encode_azimuth(azimuth, fired)
    for got, expected in zip(decode_azimuth(data, 918), (azimuth, fired), strict=True):
        np.testing.assert_array_equal(got, expected)
    assert len(data) < 120


def test_noise_costs_no_more_than_it_is():
    azimuth = np.random.default_rng(5).integers(0, 36000, (2, 2088)).astype(np.uint16)
    assert len(encode_azimuth(azimuth, all_fired(2088))) < 1.01 * azimuth.nbytes


def test_what_no_frame_can_hold_is_refused():
    fired = all_fired(3)
    with pytest.raises(SectionError, match="full turn"):
        encode_azimuth(np.array([[0, 36000, 0], [0, 0, 0]], np.uint16), fired)
    fired[1, 1] = False
    with pytest.raises(SectionError, match="repeat"):
        encode_azimuth(np.array([[0, 9, 18], [0, 8, 18]], np.uint16), fired)
    with pytest.raises(SectionError):
        encode_azimuth(np.zeros((2, 3), np.int16), fired)
    with pytest.raises(SectionError):
        encode_azimuth(np.zeros((2, 3), np.uint16), fired[:, :2])
    with pytest.raises(SectionError):
        decode_azimuth(b"\x01", 10**9)


@settings(max_examples=examples(300))
@given(st.binary(max_size=60), st.integers(0, 40))
def test_any_bytes_give_rotations_or_an_error_of_the_tree(data, width):
    try:
        azimuth, fired = decode_azimuth(data, width)
    except (SectionError, TruncatedError) as error:
        with pytest.raises(type(error)):
            reference_azimuth.decode_azimuth(data, width)
        return
    assert azimuth.shape == fired.shape == (2, width)
    assert not width or int(azimuth.max()) < 36000
    assert (azimuth.tolist(), fired.astype(int).tolist()) == reference_azimuth.decode_azimuth(data, width)


def test_cuts_and_flips_never_crash():
    azimuth, fired = s3(200)
    data = encode_azimuth(azimuth, fired)
    for at in range(8 * len(data)):
        damaged = bytearray(data)
        damaged[at // 8] ^= 1 << at % 8
        for tried in (bytes(damaged), data[: at // 8]):
            with suppress(DecodeError):
                assert int(decode_azimuth(tried, 200)[0].max()) < 36000


def test_golden_bytes():
    azimuth, fired = golden_case()
    golden = (GOLDEN / "entropy_azimuth.bin").read_bytes()
    decoded = decode_azimuth(golden, 200)
    np.testing.assert_array_equal(decoded[0], azimuth)
    np.testing.assert_array_equal(decoded[1], fired)
    assert encode_azimuth(azimuth, fired) == golden


def test_real_frames_cost_a_twentieth_of_a_byte_a_column(data_file):
    for frame in frames(data_file("kitti_sfnd_f000-049.pcap.xz"), data_file("kitti_hdl64e_s2_recovered.yaml"), 4):
        data = encode_azimuth(frame.azimuth, frame.fired)
        assert len(data) < 100
        np.testing.assert_array_equal(decode_azimuth(data, frame.width)[0], frame.azimuth)
        assert columns_in_turn(frame.azimuth) in range(2144, 2170)


def test_columns_in_a_turn():
    assert columns_in_turn(np.stack([turning(174)] * 2)) in range(2145, 2163)
    assert columns_in_turn(np.stack([turning(500, 33.4)] * 2)) in range(1070, 1086)
    lost = turning(400)
    lost[200:] += 117 * 9
    assert columns_in_turn(np.stack([lost % 36000] * 2)) in range(2145, 2163)
    for azimuth in (np.zeros((2, 0)), np.zeros((2, 1)), np.full((2, 50), 77)):
        assert columns_in_turn(azimuth.astype(np.uint16)) is None


def test_documentation_example():
    assert doctest.testmod(azimuth_coder).failed == 0
