"""The coder itself: a stream that decodes wrongly, or a cut one taken for whole, loses a frame in silence."""

from __future__ import annotations

import doctest
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarcodec.entropy import fast, number_series
from lidarcodec.errors import DecodeError, SectionError, TruncatedError
from tests.reference import range_coder as reference
from tests.sweeps import examples

DECISIONS = st.lists(st.tuples(st.integers(0, 1), st.integers(1, 65535)), max_size=300)
NUMBERS = st.one_of(st.integers(0, 3), st.integers(0, 300), st.integers(0, 2**64 - 1))


def encode(decisions: list[tuple[int, int]]) -> bytes:
    coder = reference.RangeEncoder()
    for bit, probability in decisions:
        coder.encode(bit, probability)
    return coder.finish()


def decode(data: bytes, probabilities: list[int]) -> list[int]:
    coder = reference.RangeDecoder(data)
    bits = [coder.decode(probability) for probability in probabilities]
    coder.finish()
    return bits


@given(DECISIONS)
def test_any_decisions_at_any_probability_come_back(decisions):
    assert decode(encode(decisions), [p for _, p in decisions]) == [bit for bit, _ in decisions]


def test_a_carry_runs_through_bytes_of_255():
    rng = np.random.default_rng(7)
    for _ in range(300):  # sure ones that do not come: low climbs to just under a carry, and over it
        decisions = [(int(bit), 65535 if bit == 0 else 1) for bit in rng.integers(0, 2, 60)]
        assert decode(encode(decisions), [p for _, p in decisions]) == [bit for bit, _ in decisions]


def test_nothing_costs_nothing_and_sure_bits_cost_little():
    assert encode([]) == b""
    assert len(encode([(1, 65535)] * 10_000)) <= 1
    assert len(encode([(bit & 1, 32768) for bit in range(800)])) == 100


@given(DECISIONS.filter(lambda d: len(d) > 8), st.data())
def test_a_stream_that_is_cut_or_longer_is_noticed(decisions, data):
    whole, probabilities = encode(decisions), [p for _, p in decisions]
    with pytest.raises(SectionError):
        decode(whole + data.draw(st.binary(min_size=1, max_size=3)) + b"\x01", probabilities)
    if whole:
        cut = data.draw(st.integers(0, len(whole) - 1))
        with suppress(DecodeError):
            assert decode(whole[:cut], probabilities) != [bit for bit, _ in decisions]


def test_most_damage_is_noticed_although_nothing_is_stored_for_it():
    rng = np.random.default_rng(3)
    missed = 0
    for _ in range(300):
        bits = rng.random(400) < 0.9
        decisions = [(int(bit), 58982) for bit in bits]
        damaged = bytearray(encode(decisions))
        damaged[int(rng.integers(0, len(damaged) - 1))] ^= 1 << int(rng.integers(0, 8))
        try:
            decode(bytes(damaged), [58982] * 400)
            missed += 1
        except DecodeError:
            pass
    assert missed < 100


def test_an_encoder_never_begins_with_four_bytes_of_255():
    with pytest.raises(SectionError):
        reference.RangeDecoder(b"\xff\xff\xff\xff")
    with pytest.raises(SectionError):
        fast.decode_numbers(b"\xff\xff\xff\xff", [1])


@settings(max_examples=examples(60))
@given(st.lists(st.lists(NUMBERS, max_size=60), max_size=4))
def test_numbers_native_and_reference_write_the_same_bytes(streams):
    data = fast.encode_numbers([np.array(stream, np.uint64) for stream in streams])
    assert data == reference.encode_numbers(streams)
    counts = [len(stream) for stream in streams]
    assert reference.decode_numbers(data, counts) == streams
    assert [stream.tolist() for stream in fast.decode_numbers(data, counts)] == streams


@settings(max_examples=examples(200))
@given(st.binary(max_size=80), st.lists(st.integers(0, 40), min_size=1, max_size=3))
def test_numbers_of_any_bytes_are_the_same_or_the_same_error(data, counts):
    try:
        expected = reference.decode_numbers(data, counts)
    except DecodeError as error:
        with pytest.raises(type(error)):
            fast.decode_numbers(data, counts)
    else:
        assert [stream.tolist() for stream in fast.decode_numbers(data, counts)] == expected


def test_a_count_that_the_data_has_not_earned_takes_no_memory():
    with pytest.raises(SectionError):
        fast.decode_numbers(b"\x00" * 10, [2**60])
    with pytest.raises(TruncatedError):
        fast.decode_numbers(b"\x12", [50_000])


def test_golden_bytes_of_numbers():
    streams = [[0, 0, 0, 1, 0, 0, 2, 0], [300, 301, 65535, 2**40, 2**64 - 1], []]
    assert reference.encode_numbers(streams).hex() == "b83c49af5f15d53379ff6f000000ad2197ffffa96f34000000000000000000"


@given(
    st.lists(st.integers(-(2**63), 2**63 - 1), max_size=40),
    st.sampled_from(list(number_series.Form)),
    st.integers(-number_series.MOST_LEVEL, number_series.MOST_LEVEL),
    st.integers(-number_series.MOST_RATE, number_series.MOST_RATE),
)
def test_a_series_of_any_numbers_comes_back(values, form, level, rate):
    series, line = np.array(values, np.int64), number_series.Line(level, rate)
    left = number_series.unzigzag(number_series.zigzag(number_series.residuals(series, form, line)))
    assert number_series.series(left, form, line).tolist() == values


@pytest.mark.parametrize("module", [reference, number_series])
def test_documentation_examples(module):
    assert doctest.testmod(module).failed == 0
