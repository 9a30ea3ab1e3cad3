"""Groups by activity: native and written out in Python, and what a hostile message can do with them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarcodec._native import count_activities, decode_pco_groups, split_by_activity
from lidarcodec.codecs.pcodec import compress_groups
from lidarcodec.errors import SectionError
from lidarcodec.ranges.activity import ACTIVITIES, MIN_GROUP, Groups
from tests.sweeps import examples


def activities(values: np.ndarray) -> list[int]:
    """Activity of each value, as docs/wire-format.md says it."""
    last, before, found = [0, 0, 0, 0], 0, []
    for value in values.tolist():
        found.append(sum(last).bit_length())
        change = (value - before) % 65536
        last = [*last[1:], min(change, 65536 - change)]
        before = value
    return found


values_of = st.lists(st.one_of(st.integers(0, 65535), st.integers(5000, 5010)), max_size=300).map(
    lambda given: np.array(given, np.uint16)
)


@given(values_of)
@settings(max_examples=examples(150), deadline=None)
def test_native_agrees_with_the_written_rule(values: np.ndarray) -> None:
    assert count_activities(values).tolist() == np.bincount(activities(values), minlength=ACTIVITIES).tolist()
    every = np.arange(ACTIVITIES, dtype=np.uint8)
    order = np.argsort(np.array(activities(values), int), kind="stable")
    differences = np.diff(values, prepend=np.uint16(0))[order]
    split = split_by_activity(values, every)
    np.testing.assert_array_equal(split, differences)


@given(st.integers(0, 20000), st.integers(0, 2**32))
@settings(max_examples=examples(40), deadline=None)
def test_every_stream_comes_back(size: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    scale = 2 ** rng.integers(0, 16, size)
    values = np.cumsum(rng.integers(-1, 2, size) * scale).astype(np.uint16)
    groups = Groups.of(values)
    assert sum(groups.counts) == size
    assert len(groups.counts) == 1 or min(groups.counts) >= MIN_GROUP
    parts = groups.split(values)
    assert tuple(len(part) for part in parts) == groups.counts
    if size:
        np.testing.assert_array_equal(decode_pco_groups(compress_groups(values, 8), size), values)


@pytest.mark.parametrize("starts", [(), (1,), (0, 0), (0, 5, 3), (0, 19)])
def test_groups_from_outside_are_checked(starts: tuple[int, ...]) -> None:
    with pytest.raises(SectionError, match="groups"):
        Groups(starts, (1,) * len(starts))
    with pytest.raises(SectionError, match="counts"):
        Groups((0,), ())


def test_the_native_functions_check_their_tables() -> None:
    values = np.zeros(3, np.uint16)
    for group_of in (np.zeros(18, np.uint8), np.full(19, 19, np.uint8), np.arange(19, dtype=np.uint8)[::-1].copy()):
        with pytest.raises(SectionError):
            split_by_activity(values, group_of)
    with pytest.raises(TypeError):
        split_by_activity(values.astype(np.int32), np.zeros(19, np.uint8))
