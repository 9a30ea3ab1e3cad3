"""Ranges: lossless means the very steps of the sensor and a bound means a bound, on anything, on every machine."""

from __future__ import annotations

import doctest
import hashlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarcodec.entropy import PredictiveCoder, predictive_coder
from lidarcodec.entropy.mask_coder import row_geometry
from lidarcodec.errors import SectionError, TruncatedError
from lidarcodec.sensor_model import SensorModel
from tests.entropy.frames import all_fired, mask, one_in_three, sensor
from tests.entropy.test_mask_coder import golden_sensor, layout_of, random_calibration
from tests.reference import predictive
from tests.reference.predictive import FREE, HALVES, QUICK, Given, Model
from tests.sweeps import examples
from tools import predictive_tables

SENSOR = sensor()
LEVELS = (np.arange(64) * 37 % 130).astype(np.int32)
STEPS = [1, 3, 11, 51, 501, 20001]
NATIVE = Path(__file__).parents[2] / "native" / "src"


def scene(width: int, seed: int = 1) -> np.ndarray:
    """(64, W) uint16: surfaces that rise and fall, with noise, edges, and a few wild values at both ends."""
    rng = np.random.default_rng(seed)
    surface = rng.choice([900, 4000, 9000, 30000], (8, width // 20 + 1)).repeat(8, axis=0).repeat(20, axis=1)[:, :width]
    ranges = surface + np.cumsum(rng.normal(0, 8, (64, width)), axis=1) + rng.normal(0, 4, (64, width))
    wild = rng.random((64, width)) < 0.02
    ranges[wild] = rng.choice([1, 2, 65534, 65535], int(wild.sum()))
    return np.rint(ranges).clip(1, 65535).astype(np.uint16)


def coded(ranges, returns, fired, of, step: int, levels=LEVELS, expected=None, firing=0, quick=False) -> bytes:
    """What a fresh coder writes."""
    given_to = (ranges, returns, fired, of, step, levels)
    return PredictiveCoder().encode(*given_to, expected=expected, firing=firing, quick=quick)


def decoded(data: bytes, returns, fired, of, step: int, levels=LEVELS, expected=None) -> np.ndarray:
    """What a fresh coder reads."""
    return PredictiveCoder().decode(data, returns, fired, of, step, levels, expected=expected)


def guess(ranges: np.ndarray, seed: int = 5) -> np.ndarray:
    """(64, W) uint16: what somebody expects who is often right, sometimes wrong, and sometimes knows nothing."""
    rng = np.random.default_rng(seed)
    seen = (ranges + rng.normal(0, 6, ranges.shape)).clip(1, 65535)
    seen[rng.random(ranges.shape) < 0.1] = 30000
    seen[rng.random(ranges.shape) < 0.3] = 0
    seen[rng.random(64) < 0.1] = 0
    return seen.astype(np.uint16)


def check_bound(came: np.ndarray, ranges: np.ndarray, returns: np.ndarray, step: int) -> None:
    """Every return within half a step, none of them 0; nothing elsewhere."""
    assert not came[~returns].any()
    assert came[returns].all()
    assert np.abs(came.astype(int) - ranges)[returns].max(initial=0) <= step // 2


@st.composite
def cases(draw: st.DrawFn):
    """Ranges, returns, fired, sensor, step, levels, what is expected, firings before, whether quick."""
    width, seed = draw(st.integers(0, 20)), draw(st.integers(0, 2**32))
    rng = np.random.default_rng(seed)
    fired = rng.random((2, width)) < draw(st.sampled_from([0.0, 0.4, 1.0]))
    of = sensor(seed) if draw(st.booleans()) else SensorModel("HDL-64E", random_calibration(rng))
    returns = (rng.random((64, width)) < draw(st.sampled_from([0.0, 0.02, 0.5, 0.9, 1.0]))) & fired[row_geometry(of)[0]]
    noise = rng.integers(1, draw(st.sampled_from([2, 300, 65536])), (64, width)).astype(np.uint16)
    ranges = noise if draw(st.booleans()) else scene(width, seed)
    expected = draw(st.sampled_from([None, guess(ranges, seed), ranges, ranges * np.uint16(0)]))
    if not width:
        expected = None
    levels = rng.integers(0, 1001, 64).astype(np.int32)
    step, firing, quick = draw(st.sampled_from(STEPS)), draw(st.integers(0, 99)), draw(st.booleans())
    return ranges, returns, fired, of, step, levels, expected, firing, quick


@settings(max_examples=examples(40), deadline=None)
@given(cases())
def test_any_ranges_come_back_and_native_writes_what_the_reference_writes(case) -> None:
    ranges, returns, fired, of, step, levels, expected, firing, quick = case
    data = coded(ranges, returns, fired, of, step, levels, expected, firing, quick)
    came = decoded(data, returns, fired, of, step, levels, expected)
    check_bound(came, ranges, returns, step)

    frame, cells = Given(layout_of(fired, of), step, levels.tolist(), expected), returns.view(np.uint8)
    np.testing.assert_array_equal(predictive.decode(data, cells, frame, Model()), came)
    turn = int.from_bytes(data[1:3], "little")
    counted = frame._replace(firing=firing % predictive_coder.FIRINGS, quick=quick)
    assert data == predictive.encode(ranges, cells, counted, turn, Model())


@settings(max_examples=examples(40), deadline=None)
@given(cases())
def test_free_ranges_keep_the_bound_and_come_back_as_the_encoder_says(case) -> None:
    """Else a picture shows what is not there, or the next frame is told to expect what no decoder has."""
    ranges, returns, fired, of, step, levels, expected, firing, quick = case
    about = (returns, fired, of, step, levels)
    sent = np.zeros_like(ranges)
    data = PredictiveCoder().encode(ranges, *about, firing=firing, expected=expected, quick=quick, sent=sent)
    came = decoded(data, *about, expected=expected)
    check_bound(came, ranges, returns, step)
    if step > 1 and returns.any():
        np.testing.assert_array_equal(came, sent)
        assert data[0] & FREE
    else:
        assert data == coded(ranges, *about, expected, firing, quick)

    frame, cells = Given(layout_of(fired, of), step, levels.tolist(), expected), returns.view(np.uint8)
    np.testing.assert_array_equal(predictive.decode(data, cells, frame, Model()), came)
    nearest = frame._replace(firing=firing % predictive_coder.FIRINGS, quick=quick, free=step > 1)
    other = predictive.encode(ranges, cells, nearest, int.from_bytes(data[1:3], "little"), Model())
    came = decoded(other, *about, expected=expected)
    check_bound(came, ranges, returns, step)
    np.testing.assert_array_equal(predictive.decode(other, cells, frame, Model()), came)


@pytest.mark.parametrize("quick", [False, True])
@pytest.mark.parametrize("expects", [False, True])
def test_free_ranges_take_fewer_bits_than_rounded_ones_and_lie_nearer(quick: bool, expects: bool) -> None:
    rng = np.random.default_rng(8)
    fired, returns = all_fired(1000), np.ones((64, 1000), np.bool_)
    surface = 5000 + 40 * np.arange(64)[:, None] + 900 * np.sin(np.arange(1000) / 70)
    ranges = (surface + rng.normal(0, 12, surface.shape)).astype(np.uint16)
    expected = (surface + rng.normal(0, 12, surface.shape)).astype(np.uint16) if expects else None
    about = (returns, fired, SENSOR, 101, LEVELS)
    sent = np.zeros_like(ranges)
    free = PredictiveCoder().encode(ranges, *about, expected=expected, quick=quick, sent=sent)
    rounded = coded(ranges, *about, expected, quick=quick)
    assert len(free) < 0.97 * len(rounded)
    off = [
        np.square(came.astype(float) - ranges).mean() for came in (sent, decoded(rounded, *about, expected=expected))
    ]
    assert off[0] < 0.8 * off[1]


@pytest.mark.parametrize("width", [1, 2, 7, 174, 2088])
@pytest.mark.parametrize("fired_of", [all_fired, one_in_three])
@pytest.mark.parametrize("step", [1, 11, 20001])
@pytest.mark.parametrize("quick", [False, True])
def test_frames_of_all_sizes_and_steps(width: int, fired_of, step: int, quick: bool) -> None:
    fired = fired_of(width)
    returns, ranges = mask(width) & fired[row_geometry(SENSOR)[0]], scene(width)
    data = coded(ranges, returns, fired, SENSOR, step, quick=quick)
    check_bound(decoded(data, returns, fired, SENSOR, step), ranges, returns, step)
    assert data == coded(ranges, returns, fired, SENSOR, step, quick=quick)


@pytest.mark.sweep
def test_frames_of_either_kind_follow_each_other_each_change_beginning_from_nothing() -> None:
    fired, returns = all_fired(90), mask(90)
    encoder, decoder, written, before = PredictiveCoder(), PredictiveCoder(), Model(), False
    frame = Given(layout_of(fired, SENSOR), 11, LEVELS.tolist())
    for seed, quick in enumerate([False, True, True, False, False, True]):
        ranges = scene(90, seed)
        data = encoder.encode(ranges, returns, fired, SENSOR, 11, LEVELS, quick=quick)
        check_bound(decoder.decode(data, returns, fired, SENSOR, 11, LEVELS), ranges, returns, 11)
        turn = int.from_bytes(data[1:3], "little")
        cells = returns.view(np.uint8)
        assert data == predictive.encode(ranges, cells, frame._replace(quick=quick), turn, written)
        alone = coded(ranges, returns, fired, SENSOR, 11, quick=quick)
        assert data == alone if quick != before or seed == 0 else len(data) < len(alone)
        before = quick


def test_all_kinds_but_the_one_that_what_is_known_asks_for_are_refused() -> None:
    fired, returns, ranges = all_fired(5), np.ones((64, 5), np.bool_), scene(5)
    data = bytearray(coded(ranges, returns, fired, SENSOR, 11, quick=True))
    assert data[0] == QUICK
    frame = Given(layout_of(fired, SENSOR), 11, LEVELS.tolist())
    right = {0, QUICK, FREE, QUICK | FREE}
    for kind in set(range(256)) - right - {kind | HALVES for kind in right}:
        data[0] = kind
        with pytest.raises(SectionError, match="kind"):
            decoded(bytes(data), returns, fired, SENSOR, 11)
        with pytest.raises(SectionError, match="kind"):
            predictive.decode(bytes(data), returns.view(np.uint8), frame, Model())


def test_what_a_frame_taught_makes_the_next_one_smaller() -> None:
    fired, returns, encoder, decoder = all_fired(300), mask(300), PredictiveCoder(), PredictiveCoder()
    sizes = []
    for seed in range(3):
        ranges = scene(300, seed)
        data = encoder.encode(ranges, returns, fired, SENSOR, 11, LEVELS)
        check_bound(decoder.decode(data, returns, fired, SENSOR, 11, LEVELS), ranges, returns, 11)
        sizes.append(len(data))
        if seed:
            assert len(data) < len(coded(ranges, returns, fired, SENSOR, 11))
    encoder.reset()
    assert encoder.encode(scene(300, 0), returns, fired, SENSOR, 11, LEVELS) == coded(
        scene(300, 0), returns, fired, SENSOR, 11
    )


def test_errors_that_come_again_with_the_firings_cost_less_as_long_as_firings_are_counted() -> None:
    """A turn is no multiple of 24 firings, so what is locked to them is elsewhere in each frame."""
    width, frames = 350, 8
    rng = np.random.default_rng(1)
    error = rng.integers(-12, 13, (64, predictive_coder.FIRINGS))
    noise = rng.normal(0, 4, (frames, 64, width)).round().astype(int)
    firings = (np.arange(frames * width).reshape(frames, width)) % predictive_coder.FIRINGS
    ranges = (9000 + noise + error[:, firings].swapaxes(0, 1)).astype(np.uint16)
    fired, returns = all_fired(width), np.ones((64, width), np.bool_)

    def bytes_of(counts: list[int]) -> int:
        encoder, decoder, sizes = PredictiveCoder(), PredictiveCoder(), []
        for count, frame in zip(counts, ranges, strict=True):
            data = encoder.encode(frame, returns, fired, SENSOR, 1, LEVELS, firing=count)
            check_bound(decoder.decode(data, returns, fired, SENSOR, 1, LEVELS), frame, returns, 1)
            sizes.append(len(data))
        return sum(sizes[2:])

    counted = bytes_of([i * width for i in range(frames)])
    assert counted < 0.96 * bytes_of([0] * frames)
    assert counted < 0.96 * bytes_of([int(x) for x in rng.integers(0, 24, frames)])


def test_a_good_expectation_makes_a_frame_smaller_and_decoding_needs_it() -> None:
    fired, returns, ranges = all_fired(300), mask(300), scene(300)
    seen = guess(ranges)
    data = coded(ranges, returns, fired, SENSOR, 11, expected=seen)
    assert len(data) < len(coded(ranges, returns, fired, SENSOR, 11))
    check_bound(decoded(data, returns, fired, SENSOR, 11, expected=seen), ranges, returns, 11)
    with pytest.raises(SectionError, match="kind"):
        decoded(data, returns, fired, SENSOR, 11)
    with pytest.raises(SectionError, match="expected ranges are"):
        decoded(data, returns, fired, SENSOR, 11, expected=seen[:, :5])


@pytest.mark.parametrize("width", [0, 1, 2088])
def test_no_returns_cost_nothing(width: int) -> None:
    fired, returns = all_fired(width), np.zeros((64, width), np.bool_)
    assert coded(scene(width), returns, fired, SENSOR, 1) == b""
    assert not decoded(b"", returns, fired, SENSOR, 1).any()
    with pytest.raises(SectionError, match="no returns"):
        decoded(b"\1", returns, fired, SENSOR, 1)


def test_arrays_that_do_not_fit_are_refused() -> None:
    fired, returns, ranges = all_fired(5), np.ones((64, 5), np.bool_), scene(5)
    coder = PredictiveCoder()
    with pytest.raises(SectionError, match="ranges are"):
        coder.encode(ranges[:, :4], returns, fired, SENSOR, 1, LEVELS)
    with pytest.raises(SectionError, match="ranges are"):
        coder.encode(ranges.astype(np.int32), returns, fired, SENSOR, 1, LEVELS)  # type: ignore[arg-type]
    with pytest.raises(SectionError, match="without a range"):
        coder.encode(ranges * np.uint16(0), returns, fired, SENSOR, 1, LEVELS)
    with pytest.raises(SectionError, match="did not fire"):
        coder.encode(ranges, returns, fired & False, SENSOR, 1, LEVELS)
    for step in (0, 2, 65537):
        with pytest.raises(SectionError, match="step"):
            coder.encode(ranges, returns, fired, SENSOR, step, LEVELS)
    for levels in (LEVELS - 1, LEVELS + 1000):
        with pytest.raises(SectionError, match="level"):
            coder.encode(ranges, returns, fired, SENSOR, 1, levels)
    with pytest.raises(SectionError, match="levels are"):
        coder.encode(ranges, returns, fired, SENSOR, 1, LEVELS[:3])
    with pytest.raises(SectionError, match="turn"):
        coder.encode(ranges, returns, fired, SENSOR, 1, LEVELS, turn=70000)
    with pytest.raises(SectionError, match="counted from 0"):
        coder.encode(ranges, returns, fired, SENSOR, 1, LEVELS, firing=-1)


def test_a_firing_beyond_the_pattern_is_refused() -> None:
    fired, returns, ranges = all_fired(5), np.ones((64, 5), np.bool_), scene(5)
    data = bytearray(coded(ranges, returns, fired, SENSOR, 1, firing=23))
    assert data[3] == 23
    data[3] = 24
    with pytest.raises(SectionError, match="count of firings"):
        decoded(bytes(data), returns, fired, SENSOR, 1)
    frame = Given(layout_of(fired, SENSOR), 1, LEVELS.tolist())
    with pytest.raises(SectionError, match="count of firings"):
        predictive.decode(bytes(data), returns.view(np.uint8), frame, Model())


@pytest.mark.drawn
@pytest.mark.parametrize("quick", [False, True])
def test_every_cut_and_every_changed_byte_gives_ranges_or_our_error(quick: bool) -> None:
    fired, returns, ranges = all_fired(40), mask(40), scene(40)
    data = coded(ranges, returns, fired, SENSOR, 11, quick=quick)
    damaged = [data[:cut] for cut in range(len(data))]
    refused = 0
    rng = np.random.default_rng(3)
    for _ in range(examples(600)):
        changed = bytearray(data)
        for at in rng.integers(0, len(data), int(rng.integers(1, 4))):
            changed[at] = int(rng.integers(256))
        damaged.append(bytes(changed))
    for one in damaged:
        try:
            came = decoded(one, returns, fired, SENSOR, 11)
        except (TruncatedError, SectionError):
            refused += 1
        else:
            assert not came[~returns].any()
            assert came[returns].all()
    assert refused > 0.9 * len(damaged)
    with pytest.raises((TruncatedError, SectionError)):
        decoded(data + b"\0", returns, fired, SENSOR, 11)


def golden_case() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ranges, returns and what fired, from arithmetic alone."""
    row, column = np.mgrid[0:64, 0:60]
    wave = (row * 7 + column * column // 9 + column * row // 13) % 23
    fired = np.array([np.ones(60), np.arange(60) % 3 > 0], np.bool_)
    ranges = 1500 + 90 * row + wave * 3 + np.where(column > 30, 4000, 0) + (wave == 7) * 20000
    return ranges.astype(np.uint16), (wave > 3) & fired[(row >= 32).astype(int), column], fired


FREE_GOLDEN = "955816f34f43ffe573e0a5aa316fe4386a6b0d39921fefa68319968bca7fed35"
"""Of the bytes of free ranges of `golden_case` and of what is expected beside them, both kinds of contexts."""


def free_golden_digest(path: str) -> str:
    """Names those bytes."""
    ranges, returns, fired = golden_case()
    digest = hashlib.sha256()
    for quick in (False, True):
        coder = PredictiveCoder(path)
        for step in (5, 11, 51, 201):
            sent = np.zeros_like(ranges)
            given_to = (ranges, returns, fired, golden_sensor(), step, LEVELS)
            expected = ranges // 7 * 7 if step != 11 else None
            digest.update(coder.encode(*given_to, expected=expected, quick=quick, sent=sent))
            digest.update(sent.astype("<u2").tobytes())
    return digest.hexdigest()


GOLDEN = {
    False: "11e07872ed8a3e04a26757732d799a8d2577db33d03663bd3a49dbfdca6caa2f",
    True: "0e8624ea7399849a908ecee4f970b54e02874ddee4da773fa5186501e2c9719e",
}
"""Of the bytes of `golden_case`, by whether with the quick contexts."""


def golden_digest(path: str, quick: bool) -> str:
    """Names the bytes of `golden_case` in three steps."""
    ranges, returns, fired = golden_case()
    coder, digest = PredictiveCoder(path), hashlib.sha256()
    for step in (1, 11, 51):
        digest.update(coder.encode(ranges, returns, fired, golden_sensor(), step, LEVELS, quick=quick))
    return digest.hexdigest()


@pytest.mark.parametrize("quick", [False, True])
def test_bytes_are_the_same_on_every_machine(quick: bool) -> None:
    assert golden_digest("", quick) == GOLDEN[quick]


def test_an_encoder_chooses_the_same_free_ranges_on_every_machine() -> None:
    assert free_golden_digest("") == FREE_GOLDEN


def test_free_ranges_in_single_steps_are_refused() -> None:
    fired, returns, ranges = all_fired(5), np.ones((64, 5), np.bool_), scene(5)
    data = bytearray(coded(ranges, returns, fired, SENSOR, 1))
    data[0] |= FREE
    with pytest.raises(SectionError, match="kind"):
        decoded(bytes(data), returns, fired, SENSOR, 1)
    with pytest.raises(SectionError, match="sent"):
        PredictiveCoder().encode(ranges, returns, fired, SENSOR, 11, LEVELS, sent=np.zeros((64, 4), np.uint16))


def test_the_tables_of_the_core_are_those_of_the_generator() -> None:
    assert (NATIVE / "predictive/tables.hpp").read_text() == predictive_tables.header()


def test_the_example_in_the_module_runs() -> None:
    assert doctest.testmod(predictive_coder).failed == 0
