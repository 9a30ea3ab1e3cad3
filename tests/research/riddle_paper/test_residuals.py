"""If these fail, residuals come back as others than they were, or bytes from a stranger crash a decoder."""

from __future__ import annotations

import lzma

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarcodec.errors import DecodeError, SectionError
from research.riddle_paper.residuals import (
    MOST,
    decode_sparse,
    decode_varint,
    encode_sparse,
    encode_varint,
    entropy_bits,
)
from tests.sweeps import examples

CODERS = {"sparse": (encode_sparse, decode_sparse), "varint": (encode_varint, decode_varint)}


@pytest.mark.parametrize("name", CODERS)
@settings(max_examples=examples(40), deadline=None)
@given(values=st.lists(st.one_of(st.just(0), st.integers(-70, 70), st.integers(1 - MOST, MOST - 1)), max_size=80))
def test_residuals_come_back(name: str, values: list[int]) -> None:
    encode, decode = CODERS[name]
    residuals = np.array(values, np.int64)
    assert np.array_equal(decode(encode(residuals), len(values)), residuals)


@pytest.mark.drawn
@pytest.mark.parametrize("name", CODERS)
def test_damaged_bytes_give_an_error_or_some_residuals(name: str) -> None:
    encode, decode = CODERS[name]
    rng = np.random.default_rng(4)
    residuals = np.rint(rng.laplace(0, 3, 400)).astype(np.int64)
    data = encode(residuals)
    cases = [data[:cut] for cut in range(0, len(data), 5)]
    for _ in range(examples(300)):
        damaged = bytearray(data)
        damaged[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
        cases.append(bytes(damaged))
    for case in cases:
        for count in (400, 399, 0, 5000):
            try:
                came = decode(case, count)
            except DecodeError:
                continue
            assert came.shape == (count,)
            assert count == 0 or np.abs(came).max() <= MOST


def test_a_bomb_is_not_unpacked() -> None:
    filters = [{"id": lzma.FILTER_LZMA1, "preset": 1, "dict_size": 1 << 20, "lc": 3, "lp": 0, "pb": 0}]
    bomb = lzma.compress(bytes(5_000_000), lzma.FORMAT_RAW, filters=filters)
    with pytest.raises(SectionError):
        decode_varint(bomb, 100)


def test_residuals_beyond_the_limits_are_refused() -> None:
    for encode, _ in CODERS.values():
        with pytest.raises(SectionError, match="limit"):
            encode(np.array([MOST], np.int64))
        with pytest.raises(SectionError, match="int64"):
            encode(np.array([1], np.int32))


def test_zeros_cost_nearly_nothing_sparsely_and_both_stay_near_the_entropy() -> None:
    rng = np.random.default_rng(6)
    rare = np.where(rng.random(20_000) < 0.02, rng.integers(-3, 4, 20_000), 0).astype(np.int64)
    assert len(encode_sparse(rare)) * 8 < 1.25 * entropy_bits(rare)
    dense = np.rint(rng.laplace(0, 4, 20_000)).astype(np.int64)
    for encode, _ in CODERS.values():
        assert len(encode(dense)) * 8 < 1.25 * entropy_bits(dense)
    assert entropy_bits(dense[:0]) == 0 == entropy_bits(np.zeros(9, np.int64))
