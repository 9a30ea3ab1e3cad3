"""The canvas of video: a direction keeps its column from frame to frame, and no two returns share a place."""

from __future__ import annotations

import numpy as np
import pytest

from lidarcodec.errors import SectionError
from lidarcodec.ranges.video.turn_canvas import MAX_PLACES, TurnLayout, cells, positions
from tests.contracts import frames

ALL = np.ones((2, 2088), np.bool_)


def turning(first: float, count: int, step: float = 16.714) -> np.ndarray:
    """(2, count) azimuths of a sensor that turns evenly."""
    return np.tile(((first + step * np.arange(count)) % 36000).astype(np.uint16), (2, 1))


def test_the_same_direction_is_the_same_column_in_every_frame() -> None:
    """Frames of 348 packets begin 67 columns earlier each time; what stands still must stand still on the canvas."""
    layout = TurnLayout.fitting(turning(0, 2088), ALL)
    assert layout == TurnLayout(2176, 1, anchored=True)
    for first in (0.0, 34_899.0, 17_003.5):
        azimuth = turning(first, 2088)
        places = positions(layout, azimuth, ALL)
        off = (places - azimuth.astype(np.int64) * 2176 // 36000) % 2176
        assert off.max() <= 1
        assert len(np.unique(places[0])) == 2088


@pytest.mark.parametrize("count", [2088, 2144, 2155, 2166])
def test_turns_of_any_speed_that_kitti_has_fit_one_layout(count: int) -> None:
    layout = TurnLayout.fitting(turning(0, 2144, 36000 / 2144), np.ones((2, 2144), np.bool_))
    assert layout.holds(turning(9, count, 36000 / count), np.ones((2, count), np.bool_))


@pytest.mark.parametrize("name", [*frames.ordinary(), "long", "stuck", "noise of azimuths", "widest", "two turns"])
def test_every_return_has_a_place_of_its_own(name: str) -> None:
    """Two returns in one place: one of them would come back with the other's range."""
    rng = np.random.default_rng(3)
    odd = {
        "long": turning(5, 9000),
        "stuck": np.full((2, 700), 77, np.uint16),
        "noise of azimuths": rng.integers(0, 36000, (2, 900)).astype(np.uint16),
        "widest": rng.integers(0, 36000, (2, 24576)).astype(np.uint16),
        "two turns": turning(5, 4400, 16.0),
    }
    if name in odd:
        azimuth, sensor = odd[name], frames.SENSOR
        fired = np.ones(azimuth.shape, np.bool_)
        valid = np.ones((64, azimuth.shape[1]), np.bool_)
    else:
        frame = frames.ordinary()[name]
        azimuth, fired, sensor, valid = frame.azimuth, frame.fired, frame.sensor, frame.valid
    layout = TurnLayout.fitting(azimuth, fired)
    assert layout.holds(azimuth, fired)
    assert layout.places <= MAX_PLACES
    where = cells(layout, positions(layout, azimuth, fired), sensor, valid)
    assert len(where) == int(valid.sum())
    if len(where):
        assert np.bincount(where).max() == 1
        assert where.min() >= 0
        assert where.max() < layout.shape[0] * layout.shape[1]


@pytest.mark.parametrize("layout", [(0, 1), (17, 1), (8208, 1), (16, 0), (16, 17), (8192, 5)])
def test_a_layout_that_would_take_too_much_is_refused(layout: tuple[int, int]) -> None:
    with pytest.raises(SectionError):
        TurnLayout(*layout, anchored=True)


def test_a_frame_without_room_is_refused() -> None:
    for anchored in (True, False):
        with pytest.raises(SectionError):
            positions(TurnLayout(1024, 2, anchored), turning(0, 2088), ALL)
