"""Slabs: ranges that go on where the slab before ended. What both ends know must be the same, whatever comes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarcodec.entropy import KnownColumns, PredictiveCoder, known_columns
from lidarcodec.entropy.mask_coder import row_geometry
from lidarcodec.errors import SectionError, TruncatedError
from lidarcodec.sensor_model import SensorModel
from tests.entropy.frames import all_fired, mask, sensor
from tests.entropy.test_mask_coder import layout_of, random_calibration
from tests.entropy.test_predictive_coder import LEVELS, STEPS, check_bound, guess, scene
from tests.reference import predictive
from tests.reference.predictive import Given, Model
from tests.sweeps import examples

SENSOR = sensor()
TURN = 2000


def cut(ranges, returns, fired, expected, begin: int, end: int, known: int) -> KnownColumns:
    """Columns before a slab as a decoder has them, where steps are 1."""
    seen = np.zeros_like(ranges) if expected is None else expected
    at = slice(max(begin - known, 0), begin)
    return KnownColumns(np.where(returns, ranges, 0).astype(np.uint16)[:, at], fired[:, at], seen[:, at])


@st.composite
def streams(draw: st.DrawFn):
    """Slabs of a sensor: ranges, returns, fired, expected of each, steps, how many columns each sees; whether quick."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    of = sensor(int(rng.integers(9))) if draw(st.booleans()) else SensorModel("HDL-64E", random_calibration(rng))
    slabs = []
    for _ in range(draw(st.integers(1, 4))):
        width = draw(st.integers(1, 9))
        fired = rng.random((2, width)) < draw(st.sampled_from([0.0, 0.4, 1.0]))
        cells = fired[row_geometry(of)[0]]
        returns = (rng.random((64, width)) < draw(st.sampled_from([0.0, 0.02, 0.9, 1.0]))) & cells
        ranges = scene(width, int(rng.integers(1000)))
        expected = draw(st.sampled_from([None, guess(ranges), ranges * np.uint16(0)]))
        slabs.append((ranges, returns, fired, expected, draw(st.sampled_from(STEPS)), draw(st.integers(0, 14))))
    return of, rng.integers(0, 1001, 64).astype(np.int32), slabs, draw(st.booleans())


@settings(max_examples=examples(40), deadline=None)
@given(streams())
@pytest.mark.sweep
def test_native_writes_what_the_reference_writes_slab_after_slab(stream) -> None:
    of, levels, slabs, quick = stream
    encoder, decoder, written, read = PredictiveCoder(), PredictiveCoder(), Model(), Model()
    edge = KnownColumns.none()
    for at, (ranges, returns, fired, expected, step, wanted) in enumerate(slabs):
        known = edge.last(wanted)
        count = known.ranges.shape[1]
        given = (ranges, returns, fired, of, step, levels)
        data = encoder.encode(*given, turn=TURN, firing=5 * at, expected=expected, slab_after=known, quick=quick)
        assert known_columns(data) == (count if returns.any() else None)
        came = decoder.decode(data, returns, fired, of, step, levels, expected=expected, slab_after=known)
        check_bound(came, ranges, returns, step)

        seen = None if expected is None else np.hstack([known.expected, expected])
        frame = Given(layout_of(np.hstack([known.fired, fired]), of), step, levels.tolist(), seen, count, 5 * at, quick)
        image, cells = (np.hstack(both) for both in ((known.ranges, ranges), (known.ranges != 0, returns)))
        assert data == predictive.encode(image, cells.view(np.uint8), frame, TURN, written)
        again = predictive.decode(data, cells.view(np.uint8), frame, read, image)
        np.testing.assert_array_equal(again[:, count:], came)
        edge = edge.and_then(KnownColumns(came, fired, came * np.uint16(0) if expected is None else expected))


@settings(max_examples=examples(40), deadline=None)
@given(streams(), st.lists(st.booleans(), min_size=4, max_size=4))
def test_slabs_go_on_from_free_ones_and_from_rounded_ones(stream, free) -> None:
    """A bound, a target or an operator changes the form in the middle of a stream."""
    of, levels, slabs, quick = stream
    encoder, decoder, read = PredictiveCoder(), PredictiveCoder(), Model()
    edge = KnownColumns.none()
    for at, (ranges, returns, fired, expected, step, wanted) in enumerate(slabs):
        known = edge.last(wanted)
        count = known.ranges.shape[1]
        about = (returns, fired, of, step, levels)
        sent = np.zeros_like(ranges) if free[at] else None
        told = {"expected": expected, "slab_after": known}
        data = encoder.encode(ranges, *about, turn=TURN, firing=5 * at, quick=quick, sent=sent, **told)
        assert known_columns(data) == (count if returns.any() else None)
        came = decoder.decode(data, *about, **told)
        check_bound(came, ranges, returns, step)
        if sent is not None and step > 1:
            np.testing.assert_array_equal(came, sent)
        seen = None if expected is None else np.hstack([known.expected, expected])
        frame = Given(layout_of(np.hstack([known.fired, fired]), of), step, levels.tolist(), seen, count)
        image, cells = (np.hstack(both) for both in ((known.ranges, ranges), (known.ranges != 0, returns)))
        again = predictive.decode(data, cells.view(np.uint8), frame, read, image)
        np.testing.assert_array_equal(again[:, count:], came)
        edge = edge.and_then(KnownColumns(came, fired, came * np.uint16(0) if expected is None else expected))


@pytest.mark.parametrize("expects", [False, True])
@pytest.mark.parametrize("steps", [(10001, 1), (40093, 1001)])
def test_a_near_return_behind_a_far_one_in_longer_steps_comes_back(steps: tuple[int, int], expects: bool) -> None:
    """In steps this long the largest range is rounded up, to more than what is the largest in shorter ones."""
    encoder, decoder = PredictiveCoder(), PredictiveCoder()
    returns, fired, levels = np.ones((64, 4), bool), all_fired(4), np.zeros(64, np.int32)
    edge = KnownColumns.none()
    for step, at in zip(steps, (65535, 1), strict=True):
        ranges = np.full((64, 4), at, np.uint16)
        expected = ranges if expects else None
        about = returns, fired, SENSOR, step, levels
        data = encoder.encode(ranges, *about, turn=TURN, expected=expected, slab_after=edge)
        came = decoder.decode(data, *about, expected=expected, slab_after=edge)
        check_bound(came, ranges, returns, step)
        edge = KnownColumns(came, fired, came if expects else came * np.uint16(0))


def sizes(parts: int, expects: bool, looks_back: bool) -> int:
    """Bytes of an image that is sent in so many parts."""
    width = 1200
    ranges, returns, fired = scene(width), mask(width), all_fired(width)
    seen = guess(ranges) if expects else None
    encoder, total = PredictiveCoder(), 0
    for begin in range(0, width, width // parts):
        at = slice(begin, begin + width // parts)
        known = cut(ranges, returns, fired, seen, begin, at.stop, 128 if looks_back else 0)
        part = np.ascontiguousarray(ranges[:, at]), np.ascontiguousarray(returns[:, at]), fired[:, at]
        expected = None if seen is None else np.ascontiguousarray(seen[:, at])
        total += len(
            encoder.encode(*part, SENSOR, 1, LEVELS, turn=TURN, expected=expected, slab_after=known)
        )  # fmt: skip
    return total


@pytest.mark.parametrize("expects", [False, True])
def test_columns_before_a_slab_save_most_of_what_its_edge_costs(expects: bool) -> None:
    whole, alone, joined = (sizes(*how) for how in ((1, expects, False), (12, expects, False), (12, expects, True)))
    assert joined - whole < 0.5 * (alone - whole)


def test_a_slab_is_refused_with_other_columns_than_it_was_written_with() -> None:
    ranges, returns, fired = scene(40), mask(40), all_fired(40)
    known = cut(ranges, returns, fired, None, 20, 40, 20)
    part = np.ascontiguousarray(returns[:, 20:]), fired[:, 20:], SENSOR, 1, LEVELS
    data = PredictiveCoder().encode(np.ascontiguousarray(ranges[:, 20:]), *part, turn=TURN, slab_after=known)
    came = PredictiveCoder().decode(data, *part, slab_after=known)
    np.testing.assert_array_equal(came, np.where(returns, ranges, 0)[:, 20:])
    with pytest.raises(SectionError, match="columns"):
        PredictiveCoder().decode(data, *part, slab_after=known.last(7))
    with pytest.raises(SectionError, match="kind"):
        PredictiveCoder().decode(data, *part)
    for size in range(1, 9):
        with pytest.raises(TruncatedError):
            known_columns(data[:size])
