"""`max_error_m` is a promise about every return: one that breaks it is a wrong distance in somebody's brake."""

from __future__ import annotations

import numpy as np
import pytest

from lidarcodec.errors import SectionError
from lidarcodec.ranges.quantise import MAX_STEP, check_step, quantise, reconstruct
from lidarcodec.settings import step_of

EVERY_RANGE = np.arange(1, 65536, dtype=np.uint32).astype(np.uint16)


@pytest.mark.parametrize("step", [1, 3, 5, 7, 9, 11, 21, 51, 101, 255, 257, 999, 1001, 4095, 9999, 20001])
def test_no_range_at_all_is_further_off_than_the_bound(step: int) -> None:
    indices = quantise(EVERY_RANGE, step)
    came = reconstruct(indices, step).astype(int)
    assert np.abs(came - EVERY_RANGE).max() <= (step - 1) // 2
    assert came.min() >= 1
    assert came.max() <= 65535
    assert int(indices.max()) <= (65535 + step // 2) // step


def test_many_steps_keep_the_bound_at_both_ends() -> None:
    ends = np.concatenate([EVERY_RANGE[:12000], EVERY_RANGE[-12000:]])
    for step in range(3, MAX_STEP + 1, 602):
        came = reconstruct(quantise(ends, step), step).astype(int)
        assert np.abs(came - ends).max() <= (step - 1) // 2
        assert came.min() >= 1


def test_quantising_twice_changes_nothing_more() -> None:
    """A relay that decodes and encodes again with the same bound must not drift."""
    for step in (3, 11, 51, 20001):
        once = reconstruct(quantise(EVERY_RANGE, step), step)
        np.testing.assert_array_equal(reconstruct(quantise(once, step), step), once)


@pytest.mark.parametrize(
    ("bound_m", "step"), [(0, 1), (0.001, 1), (0.002, 3), (0.01, 11), (0.02, 21), (0.1, 101), (20, 20001)]
)
def test_the_step_of_a_bound(bound_m: float, step: int) -> None:
    assert check_step(step_of(bound_m)) == step


@pytest.mark.parametrize("step", [0, 2, 20003, -1])
def test_a_step_from_outside_is_checked(step: int) -> None:
    with pytest.raises(SectionError, match="step"):
        check_step(step)


@pytest.mark.parametrize(("index", "step"), [(0, 1), (5959, 11), (65535, 3)])
def test_an_index_that_no_range_has_is_refused(index: int, step: int) -> None:
    with pytest.raises(SectionError, match="range"):
        reconstruct(np.array([1, index], np.uint16), step)
