"""Errors near and far: a codec that is good on average and bad at 60 m must not look good there."""

import numpy as np
import pytest

from lidarcodec.evaluation.range_bands import EDGES_M, RangeBands


def measured(original, decoded):
    bands = RangeBands()
    bands.add(np.array([original], np.uint16), np.array([decoded], np.uint16))
    return bands.result()


def test_quantiles_are_those_of_the_sorted_errors():
    random = np.random.default_rng(3)
    original = random.integers(5000, 10_000, 1000)
    error = random.integers(0, 400, 1000)
    (band,) = [band for band in measured(original, original + error) if band["returns"]]
    ordered = np.sort(error) * 0.002
    assert (band["from_m"], band["to_m"], band["returns"]) == (10.0, 20.0, 1000)
    assert band["p50_m"] == pytest.approx(ordered[499])
    assert band["p90_m"] == pytest.approx(ordered[899])
    assert band["p99_m"] == pytest.approx(ordered[989])
    assert band["max_m"] == pytest.approx(ordered[-1])


def test_the_original_range_says_which_band_and_edges_belong_to_the_upper_one():
    found = measured([4999, 5000, 9999, 10_000, 20_000, 40_000, 65_535], [1, 1, 1, 1, 1, 1, 1])
    assert [band["returns"] for band in found] == [1, 2, 1, 1, 2]
    assert found[-1]["max_m"] == pytest.approx(65_534 * 0.002)
    assert EDGES_M[-1] == pytest.approx(65_535 * 0.002)


def test_lost_and_invented_returns_are_not_errors():
    found = measured([5000, 0, 7000], [0, 5000, 7001])
    assert [band["returns"] for band in found] == [0, 1, 0, 0, 0]
    assert found[0] == {
        "from_m": 0,
        "to_m": 10,
        "returns": 0,
        "p50_m": None,
        "p90_m": None,
        "p99_m": None,
        "max_m": None,
    }


def test_frames_add_up_whatever_their_width():
    bands = RangeBands()
    bands.add(np.full((64, 6), 100, np.uint16), np.full((64, 6), 101, np.uint16))
    bands.add(np.full((64, 2), 100, np.uint16), np.full((64, 2), 105, np.uint16))
    first = bands.result()[0]
    assert (first["returns"], first["p50_m"], first["p90_m"], first["max_m"]) == (512, 0.002, 0.01, 0.01)
