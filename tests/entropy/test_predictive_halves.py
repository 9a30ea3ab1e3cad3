"""Frames in halves, for two cores: what both ends know must be the same, whatever comes and however many cores there
are."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarcodec.entropy import KnownColumns, PredictiveCoder
from lidarcodec.entropy.mask_coder import row_geometry
from lidarcodec.errors import SectionError, TruncatedError
from tests.entropy.frames import all_fired, mask, sensor
from tests.entropy.test_mask_coder import layout_of
from tests.entropy.test_predictive_coder import LEVELS, STEPS, check_bound, guess, scene
from tests.reference import predictive
from tests.reference.predictive import HALVES, SLAB, Given, Model
from tests.sweeps import examples

SENSOR = sensor()
WHOLE, IN_HALVES, AS_SLAB = "whole", "in halves", "as a slab"


@st.composite
def streams(draw: st.DrawFn):
    """Frames of one stream: ranges, returns, fired, expected, step, whether quick, and how each is coded."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    frames = []
    for _ in range(draw(st.integers(1, 5))):
        width = draw(st.integers(1, 9))
        fired = rng.random((2, width)) < draw(st.sampled_from([0.4, 1.0]))
        rows = np.arange(64)[:, None] < draw(st.sampled_from([0, 20, 64]))
        returns = (rng.random((64, width)) < draw(st.sampled_from([0.02, 0.9, 1.0]))) & fired[row_geometry(SENSOR)[0]]
        ranges = scene(width, int(rng.integers(1000)))
        expected = draw(st.sampled_from([None, guess(ranges)]))
        kind = draw(st.sampled_from([WHOLE, IN_HALVES, IN_HALVES, AS_SLAB]))
        step, quick = draw(st.sampled_from(STEPS)), draw(st.booleans())
        frames.append((ranges, returns & rows, fired, expected, step, quick, kind))
    return frames


@settings(max_examples=examples(30), deadline=None)
@given(streams())
def test_native_writes_and_reads_what_the_reference_does_frame_after_frame(stream) -> None:
    encoder, decoder = PredictiveCoder(at_once=True), PredictiveCoder(at_once=False)
    written, read = Model(), Model()
    for ranges, returns, fired, expected, step, quick, kind in stream:
        edge = KnownColumns.none() if kind == AS_SLAB else None
        about = (returns, fired, SENSOR, step, LEVELS)
        how = {"expected": expected, "slab_after": edge}
        data = encoder.encode(ranges, *about, turn=900, quick=quick, halves=kind == IN_HALVES, **how)
        came = decoder.decode(data, *about, **how)
        check_bound(came, ranges, returns, step)
        halves, known = kind == IN_HALVES, None if edge is None else 0
        frame = Given(layout_of(fired, SENSOR), step, LEVELS.tolist(), expected, known, 0, quick, halves=halves)
        cells = returns.view(np.uint8)
        assert data == predictive.encode(ranges, cells, frame, 900, written)
        np.testing.assert_array_equal(predictive.decode(data, cells, frame, read, ranges), came)


def test_a_copy_goes_on_from_the_models_of_both_halves() -> None:
    """Else a decoder that goes back to an earlier frame reads another picture."""
    fired, returns = all_fired(60), mask(60)
    encoder = PredictiveCoder()
    about = (returns, fired, SENSOR, 11, LEVELS)
    for seed in range(3):
        encoder.encode(scene(60, seed), *about, halves=seed > 0)
    copy = encoder.copy()
    assert copy.encode(scene(60, 7), *about, halves=True) == encoder.encode(scene(60, 7), *about, halves=True)


def test_two_threads_write_and_read_what_one_does() -> None:
    fired, returns = all_fired(600), np.ones((64, 600), np.bool_)
    about = (returns, fired, SENSOR, 3, LEVELS)

    def stream(at_once: bool) -> tuple[list[bytes], list[bytes]]:
        encoder, decoder = (PredictiveCoder(at_once=at_once) for _ in range(2))
        sent = [encoder.encode(scene(600, seed), *about, halves=seed > 0) for seed in range(3)]
        return sent, [decoder.decode(data, *about).tobytes() for data in sent]

    assert stream(at_once=True) == stream(at_once=False)


@pytest.mark.parametrize("at_once", [False, True])
def test_damaged_halves_are_refused(at_once: bool) -> None:
    fired, returns, ranges = all_fired(5), np.ones((64, 5), np.bool_), scene(5)
    about = (returns, fired, SENSOR, 11, LEVELS)
    data = PredictiveCoder().encode(ranges, *about, halves=True)
    assert data[0] == HALVES
    for size in range(1, len(data) - 8):
        with pytest.raises((TruncatedError, SectionError)):
            PredictiveCoder(at_once=at_once).decode(data[:size], *about)
    with pytest.raises(SectionError, match="kind"):
        PredictiveCoder(at_once=at_once).decode(data, *about, slab_after=KnownColumns.none())
    with pytest.raises(SectionError, match="kind"):
        PredictiveCoder(at_once=at_once).decode(bytes([data[0] | SLAB]) + data[1:], *about)
    for stream in range(7):  # a size that no stream can have
        mutated = bytearray(data)
        mutated[4 + 4 * stream : 8 + 4 * stream] = b"\xff\xff\xff\xff"
        with pytest.raises(TruncatedError, match="before their streams"):
            PredictiveCoder(at_once=at_once).decode(bytes(mutated), *about)
