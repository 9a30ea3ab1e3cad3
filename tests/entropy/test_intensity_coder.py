"""Intensities: lossless means the very bytes of the sensor, so they are exact on anything."""

from __future__ import annotations

import doctest
import itertools
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarcodec.entropy import IntensityMemory, decode_intensity, encode_intensity, intensity_coder
from lidarcodec.entropy.mask_coder import row_geometry
from lidarcodec.errors import DecodeError, SectionError, TruncatedError
from lidarcodec.sensor_model import SensorModel
from tests.entropy.frames import all_fired, frames, mask, one_in_three, sensor
from tests.entropy.test_mask_coder import golden_sensor, layout_of, random_calibration
from tests.reference import intensity
from tests.sweeps import examples

GOLDEN = Path(__file__).parent.parent / "golden"
SENSOR = sensor()


def scene(width: int, levels: int = 256, seed: int = 1) -> np.ndarray:
    """(64, W) uint8 of `levels` values: patches of even brightness with noise, and some dark cells."""
    rng = np.random.default_rng(seed)
    patch = np.repeat(rng.uniform(0, 1, (64, width // 40 + 1)), 40, axis=1)[:, :width]
    level = np.rint((patch + rng.normal(0, 0.04, (64, width))) * (levels - 1)).clip(0, levels - 1)
    level[rng.random((64, width)) < 0.1] = 0
    return np.rint(level * 255 / max(levels - 1, 1)).astype(np.uint8)


def golden_case() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Values, returns and what fired, from arithmetic alone."""
    row, column = np.mgrid[0:64, 0:60]
    wave = (row * 7 + column * column // 9 + column * row // 13) % 23
    fired = np.array([np.ones(60), np.arange(60) % 3 > 0], np.bool_)
    return (wave * 11).astype(np.uint8), (wave > 3) & fired[(row >= 32).astype(int), column], fired


@st.composite
def cases(draw: st.DrawFn):
    """Values, returns, fired, sensor."""
    width, seed = draw(st.integers(0, 24)), draw(st.integers(0, 2**32))
    rng = np.random.default_rng(seed)
    fired = rng.random((2, width)) < draw(st.sampled_from([0.0, 0.4, 1.0]))
    of = sensor(seed) if draw(st.booleans()) else SensorModel("HDL-64E", random_calibration(rng))
    returns = (rng.random((64, width)) < draw(st.sampled_from([0.0, 0.02, 0.5, 0.9, 1.0]))) & fired[row_geometry(of)[0]]
    levels = draw(st.sampled_from([1, 2, 3, 4, 5, 8, 9, 16, 17, 33, 64, 65, 100, 128, 129, 256]))
    noise = rng.choice(rng.permutation(256)[:levels], (64, width)).astype(np.uint8)
    return noise if draw(st.booleans()) else scene(width, levels, seed), returns, fired, of


@settings(max_examples=examples(60), deadline=None)
@given(cases())
def test_any_intensities_come_back_and_native_writes_what_the_reference_writes(case) -> None:
    values, returns, fired, of = case
    expected = np.where(returns, values, 0)
    data = encode_intensity(values, returns, fired, of)
    np.testing.assert_array_equal(decode_intensity(data, returns, fired, of), expected)

    layout, cells = layout_of(fired, of), returns.view(np.uint8)
    np.testing.assert_array_equal(intensity.decode_intensity(data, cells, layout), expected)
    turn, rate = int.from_bytes(data[1:3], "little"), int.from_bytes(data[3:5], "little")
    assert data == intensity.encode_intensity(values, cells, layout, turn, rate)


@settings(max_examples=examples(30), deadline=None)
@given(cases(), st.integers(0, 24), st.integers(0, 24), st.booleans())
def test_sections_go_on_from_each_other_as_the_reference_says(case, one: int, other: int, follows: bool) -> None:
    values, returns, fired, of = case
    writes, reads, taught = IntensityMemory(follows), IntensityMemory(), intensity.Memory()
    azimuth = np.random.default_rng(one).integers(0, 36000, fired.shape, np.uint16)
    cuts = sorted({0, min(one, values.shape[1]), min(other, values.shape[1]), values.shape[1]})
    for begin, end in [*itertools.pairwise(cuts), (0, values.shape[1])]:  # parts of a turn, and the turn once more
        given = (np.ascontiguousarray(image[:, begin:end]) for image in (values, returns, fired, azimuth))
        part, seen, shot, angles = given
        data = encode_intensity(part, seen, shot, of, memory=writes, azimuth=angles)
        expected = np.where(seen, part, 0)
        came = decode_intensity(data, seen, shot, of, memory=reads, azimuth=angles)
        np.testing.assert_array_equal(came, expected)
        came = intensity.decode_intensity(data, seen.view(np.uint8), layout_of(shot, of), taught, angles)
        np.testing.assert_array_equal(came, expected)


def test_a_part_that_goes_on_costs_less_and_is_nothing_without_the_one_before() -> None:
    values, fired = scene(600, 60), all_fired(600)
    returns = np.ones(values.shape, bool)
    memory = IntensityMemory()
    parts = [(values[:, at : at + 200].copy(), returns[:, :200], fired[:, :200]) for at in (0, 200, 400)]
    on = [encode_intensity(*part, SENSOR, memory=memory) for part in parts]
    alone = [encode_intensity(*part, SENSOR) for part in parts]
    assert on[0] == alone[0]
    assert sum(map(len, on[1:])) < 0.99 * sum(map(len, alone[1:]))
    for reads in (None, IntensityMemory()):
        with pytest.raises(SectionError, match="go on where nothing began"):
            decode_intensity(on[1], *parts[1][1:], SENSOR, memory=reads)


def turns(count: int) -> list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """Turns of a sensor that stands still: intensities with other noise in each, returns, what fired, azimuths."""
    rng, width = np.random.default_rng(5), 360
    fired, returns = all_fired(width), np.ones((64, width), bool)
    azimuth = np.tile(np.arange(0, 36000, 36000 // width, dtype=np.uint16), (2, 1))
    room = scene(width, 60).astype(np.int16)
    noisy = ((room + rng.integers(-2, 3, room.shape)).clip(0, 255).astype(np.uint8) for _ in range(count))
    return [(values, returns, fired, azimuth) for values in noisy]


def test_a_turn_that_follows_others_costs_a_tenth_less() -> None:
    memory = IntensityMemory(follows=True)
    following, alone = [], []
    for values, returns, fired, azimuth in turns(12):
        following.append(len(encode_intensity(values, returns, fired, SENSOR, memory=memory, azimuth=azimuth)))
        alone.append(len(encode_intensity(values, returns, fired, SENSOR)))
    assert sum(following[6:]) < 0.9 * sum(alone[6:])


def test_what_follows_needs_memory_and_azimuths_and_a_copy_of_the_memory_goes_on_alike() -> None:
    memory, reads = IntensityMemory(follows=True), IntensityMemory()
    first, second = turns(2)
    with pytest.raises(SectionError, match="needs azimuths"):
        encode_intensity(*first[:3], SENSOR, memory=memory)
    data = [encode_intensity(*turn[:3], SENSOR, memory=memory, azimuth=turn[3]) for turn in (first, second)]
    with pytest.raises(SectionError, match="of a stream, where none goes on"):
        decode_intensity(data[0], *first[1:3], SENSOR)
    with pytest.raises(SectionError, match="of a stream, where none goes on"):
        decode_intensity(data[0], *first[1:3], SENSOR, memory=IntensityMemory())
    with pytest.raises(SectionError, match=r"azimuths are \(2, W\)"):
        decode_intensity(data[0], *first[1:3], SENSOR, memory=IntensityMemory(), azimuth=first[3][:, 1:].copy())
    decode_intensity(data[0], *first[1:3], SENSOR, memory=reads, azimuth=first[3])
    for kept in (reads.copy(), reads):
        came = decode_intensity(data[1], *second[1:3], SENSOR, memory=kept, azimuth=second[3])
        np.testing.assert_array_equal(came, second[0])


@pytest.mark.parametrize("width", [1, 2, 7, 174, 2088])
@pytest.mark.parametrize("fired_of", [all_fired, one_in_three])
@pytest.mark.parametrize("levels", [2, 16, 100, 256])
def test_frames_of_all_sizes_and_levels(width: int, fired_of, levels: int) -> None:
    fired = fired_of(width)
    returns, values = mask(width) & fired[row_geometry(SENSOR)[0]], scene(width, levels)
    data = encode_intensity(values, returns, fired, SENSOR)
    np.testing.assert_array_equal(decode_intensity(data, returns, fired, SENSOR), np.where(returns, values, 0))
    assert data == encode_intensity(values, returns, fired, SENSOR)


@pytest.mark.parametrize("width", [0, 1, 2088])
def test_nothing_and_one_value_cost_next_to_nothing(width: int) -> None:
    fired = all_fired(width)
    nothing, everything = np.zeros((64, width), np.bool_), np.ones((64, width), np.bool_)
    values = np.full((64, width), 77, np.uint8)
    assert encode_intensity(values, nothing, fired, SENSOR) == b""
    data = encode_intensity(values, everything, fired, SENSOR)
    assert data == (b"\x00M" if width else b"")
    np.testing.assert_array_equal(decode_intensity(data, everything, fired, SENSOR), values)


def test_what_lies_outside_of_the_returns_is_not_looked_at() -> None:
    values, returns, fired = golden_case()
    other = np.where(returns, values, 255).astype(np.uint8)
    data = encode_intensity(values, returns, fired, golden_sensor())
    assert encode_intensity(other, returns, fired, golden_sensor()) == data


def test_few_levels_cost_less_than_their_even_share() -> None:
    returns, fired = mask(1000), all_fired(1000)
    cost = {}
    for levels in (2, 4, 16, 64, 256):
        cost[levels] = len(encode_intensity(scene(1000, levels), returns, fired, SENSOR)) * 8 / returns.sum()
        assert cost[levels] < 0.95 * np.log2(levels)
    assert sorted(cost.values()) == list(cost.values())


def test_noise_costs_little_more_than_noise() -> None:
    returns, fired = np.ones((64, 2088), np.bool_), all_fired(2088)
    values = np.random.default_rng(3).integers(0, 256, returns.shape).astype(np.uint8)
    assert len(encode_intensity(values, returns, fired, SENSOR)) < 1.06 * values.size


def test_the_widest_frame() -> None:
    returns, fired, values = mask(24576), all_fired(24576), scene(24576)
    data = encode_intensity(values, returns, fired, SENSOR)
    np.testing.assert_array_equal(decode_intensity(data, returns, fired, SENSOR), np.where(returns, values, 0))


def test_arrays_in_any_memory_order() -> None:
    values, returns, fired = golden_case()
    data = encode_intensity(values, returns, fired, golden_sensor())
    turned = encode_intensity(np.asfortranarray(values), np.asfortranarray(returns), fired[:, ::1], golden_sensor())
    assert turned == data
    came = decode_intensity(data, np.asfortranarray(returns), fired, golden_sensor())
    np.testing.assert_array_equal(came, np.where(returns, values, 0))
    azimuth = np.arange(2 * fired.shape[1], dtype=np.uint16).reshape(fired.shape)
    following = [
        encode_intensity(values, returns, fired, golden_sensor(), memory=IntensityMemory(True), azimuth=one)
        for one in (azimuth, np.asfortranarray(azimuth))
    ]
    assert following[0] == following[1]


def test_the_bytes_of_version_1_are_still_written_and_read() -> None:
    values, returns, fired = golden_case()
    path = GOLDEN / "entropy_intensity.bin"
    data = encode_intensity(values, returns, fired, golden_sensor(), turn=2154)
    assert data == path.read_bytes()
    np.testing.assert_array_equal(
        decode_intensity(path.read_bytes(), returns, fired, golden_sensor()), np.where(returns, values, 0)
    )


def test_shapes_types_and_limits_are_checked() -> None:
    values, returns, fired = golden_case()
    with pytest.raises(SectionError, match="uint8"):
        encode_intensity(values.astype(np.uint16), returns, fired, SENSOR)
    with pytest.raises(SectionError, match="intensities are"):
        encode_intensity(values[:, :-1], returns, fired, SENSOR)
    with pytest.raises(SectionError, match="returns is"):
        encode_intensity(values, returns[:-1], fired, SENSOR)
    with pytest.raises(SectionError, match="fired is"):
        decode_intensity(b"", returns, fired.astype(np.uint8), SENSOR)
    with pytest.raises(SectionError, match="limit"):
        decode_intensity(b"", np.zeros((64, 24577), np.bool_), np.zeros((2, 24577), np.bool_), SENSOR)
    with pytest.raises(SectionError, match="turn"):
        encode_intensity(values, returns, fired, SENSOR, turn=65536)
    with pytest.raises(SectionError, match="did not fire"):
        encode_intensity(values, np.ones_like(returns), np.zeros_like(fired), SENSOR)
    with pytest.raises(SectionError, match="did not fire"):
        decode_intensity(b"\0\0", np.ones_like(returns), np.zeros_like(fired), SENSOR)


def test_every_cut_is_noticed_and_no_change_does_harm() -> None:
    values, returns, fired = golden_case()
    data = encode_intensity(values, returns, fired, golden_sensor())
    for size in range(len(data)):
        with pytest.raises(DecodeError):
            decode_intensity(data[:size], returns, fired, golden_sensor())
    with pytest.raises(SectionError):
        decode_intensity(data + b"\0", returns, fired, golden_sensor())
    expected, unnoticed = np.where(returns, values, 0), 0
    for at in range(len(data)):
        changed = bytearray(data)
        changed[at] ^= 1 << at % 8
        with suppress(DecodeError):
            came = decode_intensity(bytes(changed), returns, fired, golden_sensor())
            unnoticed += bool((came != expected).any())
    assert unnoticed < len(data) // 50


@pytest.mark.parametrize(
    ("data", "error"),
    [
        (b"", TruncatedError),
        (b"\0", TruncatedError),
        (b"\0\7\0", SectionError),
        (b"\2\0", SectionError),
        (b"\1" + bytes(9), TruncatedError),
        (b"\1" + bytes(10), SectionError),
        (b"\1\0\0\0\x20" + bytes(6), SectionError),
        (b"\1\0\0\1\0\1\0" + bytes(4), TruncatedError),
        (b"\1\0\0\1\0" + bytes(2) + b"\xff" * 4, TruncatedError),
        (b"\1\0\0\1\0" + bytes(6) + b"\xff" * 8, TruncatedError),
        (b"\3\0\0\1\0" + bytes(6), SectionError),
        (b"\4\0\0\1\0" + bytes(6), SectionError),
    ],
)
def test_damaged_headers_are_refused(data: bytes, error: type[DecodeError]) -> None:
    _, returns, fired = golden_case()
    with pytest.raises(error):
        decode_intensity(data, returns, fired, golden_sensor())


def test_bytes_where_there_are_no_returns_are_refused() -> None:
    with pytest.raises(SectionError, match="no returns"):
        decode_intensity(b"\0\0", np.zeros((64, 5), np.bool_), all_fired(5), SENSOR)


@settings(max_examples=examples(200), deadline=None)
@given(st.binary(max_size=200), st.integers(0, 30), st.booleans())
def test_any_bytes_give_an_image_or_our_error(data: bytes, width: int, coded: bool) -> None:
    returns = np.random.default_rng(width).random((64, width)) < 0.7
    if coded:
        data = b"\1\0\0\1\3" + bytes([min(len(data), 30), 0, min(len(data) // 4, 30), 0, 0, 0]) + data
    with suppress(SectionError, TruncatedError):
        came = decode_intensity(data, returns, all_fired(width), SENSOR)
        assert came.shape == (64, width)
        assert not came[~returns].any()


@pytest.mark.parametrize(("capture", "limit"), [("kitti_sfnd_f000-049.pcap.xz", 3.15), ("hdl64e_s3_atwall.pcap", 6.0)])
def test_real_intensities_cost_what_they_should(data_file, capture: str, limit: float) -> None:
    calibration = "kitti_hdl64e_s2_recovered.yaml" if "kitti" in capture else "calib_ros_64e_s3-xiesc.yaml"
    frame = frames(data_file(capture), data_file(calibration), 1)[0]
    data = encode_intensity(frame.intensity, frame.valid, frame.fired, frame.sensor)
    came = decode_intensity(data, frame.valid, frame.fired, frame.sensor)
    np.testing.assert_array_equal(came, np.where(frame.valid, frame.intensity, 0))
    assert 1.0 < len(data) * 8 / frame.points < limit


def test_the_example_in_the_module_works() -> None:
    assert doctest.testmod(intensity_coder).failed == 0
