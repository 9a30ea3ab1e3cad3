"""Masks in streams with memory: a cell that comes back wrong is a ghost point or a lost one, now and ever after."""

from __future__ import annotations

import doctest
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarcodec.entropy import MaskStream, encode_mask, mask_stream
from lidarcodec.errors import DecodeError, SectionError, TruncatedError
from lidarcodec.motion.motion import Motion
from lidarcodec.motion.warp import RangeHistory, beam_rows
from tests.entropy.frames import frames, sensor
from tests.reference.mask_stream import MaskStreamReference, View
from tests.sweeps import ALL, examples

WIDEST = 40 if ALL else 16
"""Columns of a drawn frame: the reference goes through them cell by cell."""
SENSOR = sensor()
BEAMS = beam_rows(SENSOR)
HALF = BEAMS[0]


class Seen:
    """A frame: what both ends know, and its mask."""

    def __init__(
        self, seed: int, width: int, *, fired: float = 1.0, turn: int = 36000, beams: np.ndarray = BEAMS
    ) -> None:
        rng = np.random.default_rng(seed)
        first = int(rng.integers(0, 36000))
        self.azimuth = ((first + np.arange(width) * max(turn // max(width, 1), 1)) % 36000).astype(np.uint16)
        self.azimuth = np.stack([self.azimuth, (self.azimuth + rng.integers(0, 3, width)) % 36000]).astype(np.uint16)
        self.fired = rng.random((2, width)) < fired
        waves = np.sin(np.arange(64)[:, None] / 9 + self.azimuth[0].astype(int) / 700 + rng.random((64, width)))
        self.mask = (waves > rng.random() * 1.6 - 1) & self.fired[(beams[0] != 0).astype(int)]
        ranges = 3000 + 2500 * np.cos(self.azimuth[:1].astype(int) / 900) + rng.integers(0, 900, (64, width))
        self.expected = np.where(rng.random((64, width)) < 0.8, ranges, 0).astype(np.uint16)
        self.motion = Motion((int(rng.integers(-9000, 9000)), 500, int(rng.integers(-90000, 90000))),
                             (int(rng.integers(-16000, 16000)), 900, -300)).numbers  # fmt: skip
        self.beams = beams

    def known(self, *, plain: bool = False) -> tuple[np.ndarray | None, ...]:
        ahead = (None, None) if plain else (self.expected, self.motion)
        return (self.azimuth, self.fired, self.beams, *ahead)

    def view(self, *, plain: bool = False) -> View:
        motion = [1 << 30, 0, 0, 0, 1 << 30, 0, 0, 0, 1 << 30, 0, 0, 0] if plain else self.motion.tolist()
        return View(self.azimuth, self.fired.view(np.uint8), self.beams, None if plain else self.expected, motion)


def random_beams(rng: np.random.Generator) -> np.ndarray:
    beams = rng.integers(-(2**31), 2**31, (6, 64)).astype(np.int32)
    beams[0] = rng.random(64) < 0.5
    return beams


@st.composite
def streams(draw: st.DrawFn) -> list[Seen]:
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    beams = random_beams(rng) if draw(st.booleans()) else BEAMS
    turn = draw(st.sampled_from([36000, 3000]))
    fired = draw(st.sampled_from([0.0, 0.4, 1.0]))
    widths = draw(st.lists(st.integers(0, WIDEST), min_size=1, max_size=4))
    return [Seen(int(rng.integers(2**32)), width, fired=fired, turn=turn, beams=beams) for width in widths]


@settings(max_examples=examples(30), deadline=None)
@given(streams())
def test_any_stream_comes_back_and_native_writes_what_the_reference_writes(stream):
    sender, receiver, writes, reads = MaskStream(), MaskStream(), MaskStreamReference(), MaskStreamReference()
    for number, seen in enumerate(stream):
        plain = number == 0
        data = sender.encode(seen.mask, *seen.known(plain=plain))
        assert writes.encode(seen.mask.view(np.uint8), seen.view(plain=plain)) == data
        if data[0] in mask_stream.STREAM_KINDS:
            np.testing.assert_array_equal(receiver.decode(data, *seen.known(plain=plain)), seen.mask)
            np.testing.assert_array_equal(reads.decode(data, seen.view(plain=plain)), seen.mask)


@pytest.mark.parametrize("width", [1, 7, 63, 64, 65, 174, 2088, 4096])
def test_masks_of_all_sizes(width):
    sender, receiver = MaskStream(), MaskStream()
    for number in range(4):
        seen = Seen(number, width, fired=[1.0, 1.0, 0.6, 0.9][number])
        data = sender.encode(seen.mask, *seen.known())
        if len(data) > 1:
            np.testing.assert_array_equal(receiver.decode(data, *seen.known()), seen.mask)


def test_a_mask_of_one_byte_leaves_the_memory_as_it_was():
    sender, receiver, first, last = MaskStream(), MaskStream(), Seen(1, 50), Seen(2, 50)
    begun = sender.encode(first.mask, *first.known())
    assert sender.encode(np.zeros_like(first.mask), *first.known()) == b"\0"
    assert sender.encode(np.ones_like(first.mask), *first.known()) == b"\1"
    data = sender.encode(last.mask, *last.known())
    assert (begun[0], data[0]) == (6, 7)
    receiver.decode(begun, *first.known())
    np.testing.assert_array_equal(receiver.decode(data, *last.known()), last.mask)


def test_a_mask_that_goes_on_from_nothing_says_so():
    sender, seen = MaskStream(), Seen(1, 50)
    sender.encode(seen.mask, *seen.known())
    data = sender.encode(seen.mask, *seen.known())
    with pytest.raises(SectionError, match="earlier"):
        MaskStream().decode(data, *seen.known())


def test_forgetting_begins_again():
    stream, seen = MaskStream(), Seen(1, 60)
    first = stream.encode(seen.mask, *seen.known())
    assert stream.encode(seen.mask, *seen.known()) != first
    stream.forget()
    assert stream.encode(seen.mask, *seen.known()) == first


@settings(max_examples=examples(200), deadline=None)
@given(st.binary(max_size=60), st.integers(0, 30), st.sampled_from([6, 7]))
def test_any_bytes_give_a_mask_or_an_error_of_the_tree(data, width, kind):
    stream, seen = MaskStream(), Seen(3, width, fired=0.7)
    stream.encode(seen.mask, *seen.known())
    with suppress(SectionError, TruncatedError):
        cells = stream.decode(bytes([kind]) + data, *seen.known())
        assert cells.shape == (64, width)
        assert not cells[~seen.fired[HALF]].any()


def test_no_cut_passes_for_the_whole_and_flips_never_crash():
    seen = Seen(5, 40)
    data = MaskStream().encode(seen.mask, *seen.known())
    for cut in range(len(data)):
        with suppress(DecodeError):
            assert not np.array_equal(MaskStream().decode(data[:cut], *seen.known()), seen.mask)
    for at in range(0, 8 * len(data), 3):
        damaged = bytearray(data)
        damaged[at // 8] ^= 1 << at % 8
        with suppress(DecodeError):
            assert MaskStream().decode(bytes(damaged), *seen.known()).shape == (64, 40)


def test_arrays_that_do_not_fit_are_refused():
    seen = Seen(1, 20)
    wrong = seen.azimuth + np.uint16(40000)
    for given_ in [
        (seen.mask[:, :5], seen.azimuth, seen.fired, BEAMS),
        (seen.mask.view(np.uint8), seen.azimuth, seen.fired, BEAMS),
        (seen.mask, seen.azimuth, seen.fired.view(np.uint8), BEAMS),
        (seen.mask, seen.azimuth[:, :5], seen.fired, BEAMS),
        (seen.mask, wrong, seen.fired, BEAMS),
        (seen.mask, seen.azimuth, seen.fired, BEAMS[:5].copy()),
        (seen.mask, seen.azimuth, seen.fired, BEAMS, seen.expected[:, :3]),
        (seen.mask, seen.azimuth, seen.fired, BEAMS, seen.expected, seen.motion[:9].copy()),
        (np.ones_like(seen.mask), seen.azimuth, seen.fired & False, BEAMS),
    ]:
        with pytest.raises(SectionError):
            MaskStream().encode(*given_)


def test_real_frames_cost_less_than_masks_coded_with_the_one_before(data_file):
    found = frames(data_file("kitti_sfnd_f000-049.pcap.xz"), data_file("kitti_hdl64e_s2_recovered.yaml"), 6)
    sender, receiver, history, still = MaskStream(), MaskStream(), RangeHistory(), Motion((0, 0, 0), (0, 0, 0))
    stream = single = 0
    before = None
    for frame in found[:5]:
        ahead = ()
        if before is not None:
            ahead = (history.expected(still, frame.azimuth, frame.fired, frame.sensor), still.numbers)
        known = (frame.azimuth, frame.fired, beam_rows(frame.sensor), *ahead)
        data = sender.encode(frame.valid, *known)
        np.testing.assert_array_equal(receiver.decode(data, *known), frame.valid)
        if before is not None:
            stream += len(data)
            single += len(encode_mask(frame.valid, frame.fired, frame.sensor, before))
        before = frame.valid
        history.remember(frame.range_u16, frame.azimuth, frame.fired, frame.sensor)
    assert stream < 0.93 * single


def test_documentation_example():
    assert doctest.testmod(mask_stream).failed == 0
