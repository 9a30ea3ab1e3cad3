"""What a user loses if these fail: differences that are none, and errors that are too small."""

import numpy as np
import pytest

from lidarcodec.evaluation.detection.boxes import upright
from lidarcodec.evaluation.detection.evaluate import NOTHING, Detection
from lidarcodec.evaluation.detection.objects import objects_in
from lidarcodec.evaluation.detection.scores import mean_and_error
from lidarcodec.settings import StreamSettings


def test_what_happens_to_one_object_in_many_frames_counts_as_one_observation():
    values = np.repeat([0.0, 1.0, 1.0, 0.0], 50)
    tracks = np.repeat(np.arange(4), 50)
    mean, error = mean_and_error(values, tracks, 1)
    assert mean == 0.5
    assert 0.2 < error < 0.3  # of four observations; 0.035 of two hundred
    assert mean_and_error(values[:50], tracks[:50], 1) == (0.0, None)
    assert mean_and_error(np.full(2, np.nan), np.arange(2), 1) == (None, None)


def test_a_frame_that_did_not_arrive_has_lost_its_objects():
    boxes = upright(["car"], [1], np.zeros((1, 3)), np.ones((1, 3)), np.zeros(1))
    nothing = objects_in(boxes, NOTHING)
    assert not nothing.found[0]
    assert nothing.returns[0] == 0


@pytest.fixture(scope="module")
def drive():
    return Detection("sim:street?frames=2", None)


def test_lossless_frames_have_the_objects_of_the_original(drive):
    original, found = drive.original(), drive.setting(StreamSettings(codec="zstd"))
    for name in ("found", "returns", "size_error_m", "objects", "tracks"):
        assert found[name] == original[name]
    assert found["found_difference"] == found["size_error_difference"] == 0
    assert found["ground_iou"] == 1
    assert original["objects"] > 15
    assert 0.5 < original["found"] <= 1
    assert found["kinds"].keys() == {"car"}


def test_fewer_columns_leave_fewer_returns(drive):
    found = drive.setting(StreamSettings(codec="predictive", reduction="columns:6"))
    assert 0.1 < found["returns"] < 0.25
    assert found["frames_left_out"] == 0
    assert found["kbps"] > 100


def test_the_boxes_of_a_simulated_drive_hold_its_vehicles(drive):
    first = drive.frames[0]
    assert len(set(first.boxes.tracks)) == len(first.boxes) > 10
    assert np.count_nonzero(first.counted) > 8
    again = Detection("sim:street?frames=1", None).frames[0]
    assert np.array_equal(again.boxes.middle, first.boxes.middle)
