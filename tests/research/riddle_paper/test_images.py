"""If these fail, the paper's image is not within half a step of what was measured, or the baselines look ahead."""

from __future__ import annotations

import numpy as np
import pytest

from lidarcodec.errors import LidarCodecError
from research.riddle_paper.baselines import BASELINES
from research.riddle_paper.images import PaperImage, image_of, previous_valid, ranges_of
from tests.research.riddle_paper.scenes import toy_frame, toy_ranges


def some_ranges(seed: int = 3) -> np.ndarray:
    ranges = np.random.default_rng(seed).integers(1, 65536, (64, 90)).astype(np.uint16)
    ranges[np.random.default_rng(seed + 1).random(ranges.shape) < 0.2] = 0
    return ranges


@pytest.mark.parametrize("step", [1, 2, 10, 11, 50, 51, 1000])
def test_no_range_is_off_by_more_than_half_a_step(step: int) -> None:
    frame = toy_frame(some_ranges())
    sent = ranges_of(image_of(frame, step), frame)
    assert np.array_equal(sent > 0, frame.range > 0)
    apart = np.abs(sent.astype(int) - frame.range)[frame.range > 0]
    assert apart.max() <= step // 2


def test_rows_of_an_image_look_in_one_direction_in_each_column() -> None:
    image = image_of(toy_frame(np.full((64, 400), 5000, np.uint16), first=35000), 10)
    azimuth = np.where(image.valid, image.azimuth, np.nan)
    spread = np.nanmax(azimuth, axis=0) - np.nanmin(azimuth, axis=0)
    assert spread.max() < 0.0033  # a column of 0.18 degree; the lasers themselves look 5.7 degrees apart
    assert np.nanmin(np.diff(azimuth, axis=1)) > 0  # no jump where the azimuth passes 360 degrees


def test_a_step_below_one_is_refused() -> None:
    with pytest.raises(LidarCodecError, match="at least 1"):
        image_of(toy_frame(some_ranges()), 0)


@pytest.mark.parametrize("name", BASELINES)
def test_a_baseline_never_looks_ahead(name: str) -> None:
    guess = BASELINES[name]
    image = PaperImage.plain(toy_ranges(1, 12, 40), 10)
    before = guess(image.cells, image.valid)
    rng = np.random.default_rng(5)
    for _ in range(40):
        row, column = int(rng.integers(12)), int(rng.integers(40))
        changed = image.cells.copy()
        later = np.arange(12 * 40).reshape(12, 40) >= row * 40 + column
        changed[later & image.valid] += 500
        after = guess(changed, image.valid)
        assert np.array_equal(after.ravel()[: row * 40 + column + 1], before.ravel()[: row * 40 + column + 1])


def test_the_previous_valid_is_to_the_left_or_above() -> None:
    cells = np.array([[0, 5, 6, 0, 8], [0, 0, 9, 0, 0]], np.int32)
    assert previous_valid(cells, cells > 0).tolist() == [[0, 0, 5, 6, 6], [0, 5, 6, 9, 9]]
    assert previous_valid(cells[:, :0], cells[:, :0] > 0).shape == (2, 0)


def test_a_straight_line_is_foreseen() -> None:
    cells = (1000 + 7 * np.arange(30, dtype=np.int32))[None]
    valid = np.random.default_rng(2).random(cells.shape) > 0.3
    guess = BASELINES["linear extrapolation"](cells, valid)
    seen = np.cumsum(valid, axis=1) - valid
    assert np.array_equal(guess[seen >= 2], cells[seen >= 2])
