"""Few values in place of all intensities: as few as asked for, fewer bits, and errors as small as those allow."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarcodec.entropy import choose_levels, decode_intensity, encode_intensity
from lidarcodec.errors import SectionError
from tests.entropy.frames import all_fired, sensor
from tests.entropy.test_intensity_coder import cases, scene
from tests.sweeps import examples

SENSOR = sensor()


def bits_and_error(image: np.ndarray, values: np.ndarray, returns: np.ndarray) -> tuple[float, float]:
    """Bits a return, and the root of the mean squared error, of 255."""
    data = encode_intensity(image, returns, all_fired(values.shape[1]), SENSOR)
    off = image[returns].astype(float) - values[returns]
    return 8 * len(data) / returns.sum(), float(np.sqrt(np.square(off).mean()))


def evenly(values: np.ndarray, levels: int) -> np.ndarray:
    """Each as the nearest of evenly spaced values."""
    return np.rint(np.rint(values / 255 * (levels - 1)) * 255 / (levels - 1)).astype(np.uint8)


@settings(max_examples=examples(60), deadline=None)
@given(cases(), st.integers(2, 255))
def test_any_intensities_become_at_most_so_many_values_that_come_back(case, levels) -> None:
    values, returns, fired, of = case
    image = choose_levels(values, returns, fired, of, levels)
    assert image.dtype == np.uint8
    assert not image[~returns].any()
    before, after = values[returns], image[returns]
    assert len(np.unique(after)) <= levels
    if len(np.unique(before)) <= levels:
        np.testing.assert_array_equal(after, before)
    elif before.size:
        assert before.min() <= after.min()
        assert after.max() <= before.max()
        assert np.square(after.astype(float) - before).mean() <= np.var(before) + 0.25
    np.testing.assert_array_equal(
        decode_intensity(encode_intensity(image, returns, fired, of), returns, fired, of), image
    )
    np.testing.assert_array_equal(choose_levels(values, returns, fired, of, levels), image)


@pytest.mark.parametrize("levels", [4, 8, 16, 32])
def test_a_scene_is_shown_better_than_by_as_many_bits_of_evenly_spaced_values(levels: int) -> None:
    values = scene(400)
    returns = np.random.default_rng(5).random(values.shape) < 0.9
    bits, error = bits_and_error(choose_levels(values, returns, all_fired(400), SENSOR, levels), values, returns)
    others = [bits_and_error(evenly(values, n), values, returns) for n in range(2, 33)]
    beaten = [other for other in others if other[0] <= bits]
    assert bits < bits_and_error(evenly(values, levels), values, returns)[0]
    assert all(error < of_other for _, of_other in beaten)


def test_noise_about_the_edge_of_two_values_costs_nearly_nothing() -> None:
    rng = np.random.default_rng(3)
    values = np.where(np.arange(600) < 300, 60, 180) + rng.integers(-12, 13, (64, 600))
    values = values.astype(np.uint8)
    returns = np.ones(values.shape, np.bool_)
    image = choose_levels(values, returns, all_fired(600), SENSOR, 3)
    bits, error = bits_and_error(image, values, returns)
    assert bits < 0.05
    assert error < 8.0


def test_what_does_not_vary_stays() -> None:
    returns = np.ones((64, 9), np.bool_)
    for value in (0, 1, 255):
        same = np.full((64, 9), value, np.uint8)
        np.testing.assert_array_equal(choose_levels(same, returns, all_fired(9), SENSOR, 2), same)
    one = np.zeros((64, 9), np.bool_)
    one[40, 3] = True
    values = scene(9)
    np.testing.assert_array_equal(choose_levels(values, one, all_fired(9), SENSOR, 2), np.where(one, values, 0))
    none = np.zeros((64, 0), np.uint8)
    assert choose_levels(none, none.astype(np.bool_), all_fired(0), SENSOR, 2).shape == (64, 0)
    assert not choose_levels(values, np.zeros((64, 9), np.bool_), all_fired(9), SENSOR, 16).any()


def test_what_does_not_fit_is_refused() -> None:
    values, returns, fired = scene(6), np.ones((64, 6), np.bool_), all_fired(6)
    for levels in (-1, 0, 1, 256):
        with pytest.raises(SectionError, match="levels"):
            choose_levels(values, returns, fired, SENSOR, levels)
    with pytest.raises(SectionError):
        choose_levels(values.astype(np.int64), returns, fired, SENSOR, 4)  # type: ignore[arg-type]
    with pytest.raises(SectionError):
        choose_levels(values[:, :5], returns, fired, SENSOR, 4)
    with pytest.raises(SectionError):
        choose_levels(values, returns, np.zeros((2, 6), np.bool_), SENSOR, 4)
