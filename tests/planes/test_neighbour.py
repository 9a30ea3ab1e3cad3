"""Intensities in groups by their neighbour: exact on anything, and refused when they cannot be."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarcodec._native import join_by_neighbour, split_by_neighbour
from lidarcodec.entropy.zstd_frames import compress
from lidarcodec.errors import SectionError
from lidarcodec.planes.neighbour import MIN_GROUP, encode_bytes
from tests.contracts import frames
from tests.planes.one_section import read_intensity
from tests.sweeps import examples


def decode_bytes(data: bytes, size: int) -> np.ndarray:
    """The intensities of `size` returns, in columns of which the last may have fewer."""
    width = -(-size // 64)
    valid = (np.arange(64 * width) < size).reshape(64, width)
    return read_intensity(b"\0" + data, valid, np.ones((2, width), np.bool_), frames.SENSOR)[valid]


@given(st.lists(st.integers(0, 255), max_size=200).map(lambda given: np.array(given, np.uint8)), st.integers(1, 256))
@settings(max_examples=examples(150), deadline=None)
def test_native_agrees_with_a_stable_sort(values: np.ndarray, groups: int) -> None:
    group_of = (np.arange(256) * groups // 256).astype(np.uint8)
    before = np.concatenate([[0], values[:-1]]).astype(np.uint8)[: len(values)]
    order = np.argsort(group_of[before], kind="stable")
    split = split_by_neighbour(values, group_of)
    np.testing.assert_array_equal(split, values[order])
    counts = np.bincount(group_of[before], minlength=256).astype(np.uint32)
    np.testing.assert_array_equal(join_by_neighbour(split, group_of, counts), values)


@given(st.integers(0, 60_000), st.integers(1, 256), st.integers(0, 2**32))
@settings(max_examples=examples(40), deadline=None)
def test_everything_comes_back(size: int, levels: int, seed: int) -> None:
    values = np.random.default_rng(seed).integers(0, levels, size).astype(np.uint8)
    data = encode_bytes(values)
    np.testing.assert_array_equal(decode_bytes(data, size), values)
    assert data[0] <= max(1, size // MIN_GROUP)


def test_every_value_may_have_enough_for_a_group() -> None:
    values = np.tile(np.arange(256, dtype=np.uint8), MIN_GROUP + 1)
    data = encode_bytes(values)
    assert data[0] == 255
    np.testing.assert_array_equal(decode_bytes(data, len(values)), values)


def test_groups_pay() -> None:
    rng = np.random.default_rng(5)
    values = np.clip(np.cumsum(rng.integers(-3, 4, 100_000)) % 256, 0, 255).astype(np.uint8)
    assert encode_bytes(values)[0] > 10
    assert len(encode_bytes(values)) < 0.9 * len(compress(values.tobytes(), 3))


def test_what_does_not_add_up_is_refused() -> None:
    values = (np.arange(20_000) * 7 % 256).astype(np.uint8)
    data = encode_bytes(values)
    assert data[0] > 1
    for wrong in (b"", b"\0", b"\1", data[:-1], data + b"\0", b"\1" + data[1:], b"\xff" + data[1:]):
        with pytest.raises(SectionError):
            decode_bytes(wrong, len(values))
    for size in (0, len(values) - 1, len(values) + 1):
        with pytest.raises(SectionError, match="add up"):
            decode_bytes(data, size)
    swapped = bytearray(data)  # counts of two groups exchanged: the frames no longer hold what is announced
    swapped[2:6], swapped[11:15] = data[11:15], data[2:6]
    with pytest.raises(SectionError):
        decode_bytes(bytes(swapped), len(values))


def test_groups_that_run_out_are_refused() -> None:
    every = np.arange(256, dtype=np.uint8)
    counts = np.zeros(256, np.uint32)
    counts[[0, 9]] = 2, 1
    with pytest.raises(SectionError, match="ran out"):
        join_by_neighbour(np.array([5, 5, 5], np.uint8), every, counts)
    with pytest.raises(SectionError, match="add up"):
        join_by_neighbour(np.array([5, 5], np.uint8), every, counts)
    with pytest.raises(SectionError, match="256"):
        split_by_neighbour(np.zeros(3, np.uint8), np.zeros(255, np.uint8))
