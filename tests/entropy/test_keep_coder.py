"""Keep masks: a return that comes back in another place is a point that never was, so they are exact on anything."""

from __future__ import annotations

import doctest
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarcodec import _native, api
from lidarcodec.entropy import decode_keep, encode_keep, encode_mask, keep_coder
from lidarcodec.entropy.mask_coder import as_bytes, frame_geometry, row_geometry
from lidarcodec.errors import DecodeError, SectionError
from lidarcodec.motion.history import MaskHistory
from lidarcodec.reduction import make_reducer
from lidarcodec.settings import StreamSettings
from tests.entropy.frames import all_fired, one_in_three, sensor
from tests.entropy.test_mask_coder import SENSOR, golden_sensor, layout_of, random_calibration
from tests.entropy.test_mask_coder import SensorModel as Sensor
from tests.reference import keep as reference_keep
from tests.sweeps import examples

GOLDEN = Path(__file__).parent.parent / "golden"


def azimuths(width: int, step: int = 17, start: int = 35000) -> np.ndarray:
    """(2, W) uint16 of a sensor that turns evenly."""
    return np.tile(((start + np.arange(width) * step) % 36000).astype(np.uint16), (2, 1))


def golden_case() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A keep mask, azimuths, what fired, and an earlier mask, from arithmetic alone."""
    row, column = np.mgrid[0:64, 0:90]
    wave = (row * 7 + column * column // 9 + column * row // 13) % 23
    fired = np.array([np.ones(90), np.arange(90) % 3 > 0], np.bool_)
    return (wave == 3) & fired[(row >= 32).astype(int), column], azimuths(90), fired, np.roll(wave == 3, 1, axis=1)


def sparse(keep: np.ndarray, azimuth: np.ndarray, fired: np.ndarray, of: Sensor, earlier: np.ndarray | None) -> bytes:
    """As kind 4 or 5, whatever is smaller."""
    before = np.zeros((64, 0), np.bool_) if earlier is None else earlier
    return _native.encode_keep(as_bytes(keep), azimuth, *frame_geometry(fired, of), as_bytes(before))


@st.composite
def cases(draw: st.DrawFn):
    """Mask, azimuths, fired, earlier mask or none, sensor."""
    width, seed = draw(st.integers(0, 30)), draw(st.integers(0, 2**32))
    rng = np.random.default_rng(seed)
    fired = rng.random((2, width)) < draw(st.sampled_from([0.0, 0.4, 1.0]))
    of = sensor(seed) if draw(st.booleans()) else Sensor("HDL-64E", random_calibration(rng))
    turning = azimuths(width, draw(st.sampled_from([0, 8, 17, 18, 400])), int(rng.integers(36000)))
    azimuth = turning if draw(st.booleans()) else rng.integers(0, 36000, (2, width)).astype(np.uint16)
    keep = (rng.random((64, width)) < draw(st.sampled_from([0.0, 0.07, 0.5, 1.0]))) & fired[row_geometry(of)[0]]
    return keep, azimuth, fired, rng.random((64, width)) < 0.1 if draw(st.booleans()) else None, of


@settings(max_examples=examples(25), deadline=None)
@given(cases())
def test_any_mask_comes_back_and_native_writes_what_the_reference_writes(case):
    keep, azimuth, fired, earlier, of = case
    data = encode_keep(keep, azimuth, fired, of, earlier)
    np.testing.assert_array_equal(decode_keep(data, azimuth, fired, of, earlier), keep)

    layout = layout_of(fired, of)
    before = None if earlier is None or not earlier.shape[1] else earlier.view(np.uint8)
    data = sparse(keep, azimuth, fired, of, earlier)
    assert data == reference_keep.encode_keep(keep.view(np.uint8), layout, azimuth, before)
    np.testing.assert_array_equal(decode_keep(data, azimuth, fired, of, earlier), keep)
    np.testing.assert_array_equal(reference_keep.decode_keep(data, layout, azimuth, before), keep)


def test_whatever_is_smaller_is_sent():
    columns = np.zeros((64, 2088), np.bool_)
    columns[:, ::8] = True
    few = np.zeros((64, 2088), np.bool_)
    few[::4, ::32] = True
    kinds = [encode_keep(mask, azimuths(2088), all_fired(2088), SENSOR)[0] for mask in (columns, few, ~few & few)]
    assert kinds == [2, 4, 0]


def test_masks_of_voxel_take_three_bits_a_return(data_file):
    frames = list(api.read_frames(data_file("kitti_tracking0006_f000-010.pcap.xz")))[:3]
    reducer, history = make_reducer(StreamSettings(reduction="voxel", keep_points=9000)), MaskHistory()
    for frame in frames:
        keep = reducer.reduce(frame).valid
        given = (keep, frame.azimuth, frame.fired, frame.sensor)
        alone = encode_keep(*given)
        earlier = history.before(frame.azimuth, frame.sensor)
        after = encode_keep(*given, earlier)
        np.testing.assert_array_equal(decode_keep(after, *given[1:], earlier), keep)
        assert 8 * len(alone) / 9000 < 3.2
        assert len(alone) < 0.85 * len(encode_mask(keep, frame.fired, frame.sensor))
        assert frame.index == 0 or len(after) < 0.99 * len(alone)
        history.remember(keep, frame.azimuth, frame.sensor)


@pytest.mark.parametrize(
    ("keep", "azimuth", "fired", "earlier"),
    [
        (np.eye(64, 4, dtype=np.bool_), azimuths(5), all_fired(4), None),
        (np.eye(64, 4, dtype=np.bool_), azimuths(4).astype(np.int32), all_fired(4), None),
        (np.eye(64, 4, dtype=np.bool_), azimuths(4) * 0 + np.uint16(36000), all_fired(4), None),
        (np.eye(64, 4, dtype=np.bool_), azimuths(4), all_fired(4), np.zeros((64, 5), np.bool_)),
        (np.eye(63, 4, dtype=np.bool_), azimuths(4), all_fired(4), None),
        (np.eye(64, 4, dtype=np.bool_), azimuths(4), ~all_fired(4), None),
    ],
)
def test_what_does_not_fit_is_refused(keep, azimuth, fired, earlier):
    with pytest.raises(SectionError):
        encode_keep(keep, azimuth, fired, SENSOR, earlier)
    data = bytes([4 if earlier is None else 5]) + bytes(20)
    if keep.shape[0] == 64 and fired.all():
        with pytest.raises(SectionError):
            decode_keep(data, azimuth, fired, SENSOR, earlier)


def test_a_mask_that_needs_an_earlier_one_says_so():
    keep, azimuth, fired, earlier = golden_case()
    data = sparse(keep, azimuth, fired, golden_sensor(), earlier)
    with pytest.raises(SectionError, match="earlier"):
        decode_keep(data, azimuth, fired, golden_sensor())


@settings(max_examples=examples(150), deadline=None)
@given(st.binary(max_size=60), st.integers(0, 30), st.booleans(), st.integers(0, 6))
def test_any_bytes_give_a_mask_or_an_error_of_the_tree(data, width, with_earlier, kind):
    fired, earlier = one_in_three(width), np.zeros((64, width), np.bool_) if with_earlier else None
    with suppress(DecodeError):
        keep = decode_keep(bytes([kind]) + data, azimuths(width), fired, SENSOR, earlier)
        assert keep.shape == (64, width)
        assert not keep[~fired[row_geometry(SENSOR)[0]]].any()


def test_no_cut_passes_for_the_whole_and_flips_never_crash():
    keep, azimuth, fired, _ = golden_case()
    data = sparse(keep, azimuth, fired, golden_sensor(), None)
    for cut in range(len(data)):
        with suppress(DecodeError):
            assert not np.array_equal(decode_keep(data[:cut], azimuth, fired, golden_sensor()), keep)
    for at in range(8 * len(data)):
        damaged = bytearray(data)
        damaged[at // 8] ^= 1 << at % 8
        with suppress(DecodeError):
            assert decode_keep(bytes(damaged), azimuth, fired, golden_sensor()).shape == (64, 90)


@pytest.mark.parametrize("name", ["entropy_keep_alone", "entropy_keep_with_earlier"])
def test_golden_bytes(name):
    keep, azimuth, fired, earlier = golden_case()
    golden = (GOLDEN / f"{name}.bin").read_bytes()
    before = earlier if name.endswith("earlier") else None
    np.testing.assert_array_equal(decode_keep(golden, azimuth, fired, golden_sensor(), before), keep)
    layout = layout_of(fired, golden_sensor())
    earlier8 = None if before is None else before.view(np.uint8)
    assert reference_keep.encode_keep(keep.view(np.uint8), layout, azimuth, earlier8) == golden


def test_documentation_example():
    assert doctest.testmod(keep_coder).failed == 0
