"""The tables of docs/evaluation.md at equal RMSE: read between two results, and never beyond them."""

import json
import math
from pathlib import Path

import pytest

from benchmarks.curve_tables import at_rmse, draw, text
from benchmarks.curves import RESULTS, RUNS

PAGE = Path(__file__).resolve().parents[2] / "docs" / "evaluation.md"


def result(rmse_m, bits, codec="jpeg"):
    return {
        "codec": codec,
        "rmse_m": rmse_m,
        "bits_per_point": {"geometry": bits, "total": bits},
        "kbps_at_10hz": bits * 1000,
    }


def test_between_two_results_both_are_straight_on_logarithmic_scales():
    results = [result(0.04, 4.0), result(0.01, 8.0), result(0.09, 100.0, "png"), result(0.0, 20.0)]
    assert at_rmse(results, "jpeg", 0.02) == pytest.approx((math.sqrt(32), 1000 * math.sqrt(32)))
    assert at_rmse(results, "jpeg", 0.04) == pytest.approx((4.0, 4000.0))


@pytest.mark.parametrize("rmse_m", [0.009, 0.041])
def test_nothing_is_said_where_nothing_was_measured(rmse_m):
    assert at_rmse([result(0.04, 4.0), result(0.01, 8.0)], "jpeg", rmse_m) is None
    assert at_rmse([result(0.04, 4.0)], "h264", rmse_m) is None


def test_the_page_shows_what_the_results_say():
    known = json.loads(RESULTS.read_text())["scenes"]
    assert list(known) == list(RUNS)
    assert text(known) in PAGE.read_text()


@pytest.mark.sweep
def test_the_pictures_of_the_page_are_small(tmp_path):
    known = json.loads(RESULTS.read_text())["scenes"]
    draw(known, tmp_path)
    for picture in tmp_path.iterdir():
        committed = PAGE.parent / picture.name
        assert 5_000 < committed.stat().st_size < 60_000, picture.name
