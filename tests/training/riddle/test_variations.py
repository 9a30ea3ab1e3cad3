"""If these fail, networks are trained on sensors that cannot be: points where no beam of the unit goes."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

pytest.importorskip("torch", reason="training needs torch: the extra `learned`")

import lidarcodec
from lidarcodec.frame import Frame
from lidarcodec.training.riddle.drives import CLIP_FRAMES, clips, simulated_drives
from lidarcodec.training.riddle.variations import Variation
from lidarcodec.units import LASERS

NONE = np.zeros(LASERS, np.int64)


@pytest.fixture(scope="module")
def frame() -> Frame:
    return next(lidarcodec.read_frames("sim:city?frames=1&seed=5"))


def places(frame: Frame) -> np.ndarray:
    """(64, W, 3) metres, 0 where there is no return."""
    cloud = frame.cloud()
    image = np.zeros((frame.width, LASERS, 3))
    image[frame.valid.T] = np.stack([cloud["x"], cloud["y"], cloud["z"]], axis=1)
    return image.transpose(1, 0, 2)


def test_a_unit_with_other_distance_corrections_sees_the_same_points(frame: Frame) -> None:
    level = np.random.default_rng(1).integers(-100, 300, LASERS)
    unit = Variation(level, NONE, NONE, np.zeros(LASERS), False)
    (seen,) = unit.of([frame], np.random.default_rng(1))
    kept = seen.range > 1  # what would lie before the sensor is not told
    assert np.array_equal(seen.range[kept], (frame.range + level[frame.sensor.laser_of_ring][:, None])[kept])
    assert np.count_nonzero(seen.range) == frame.points
    assert seen.sensor.hash != frame.sensor.hash
    assert np.abs(places(seen) - places(frame)).max() < 0.002


def test_the_mirror_changes_left_and_right(frame: Frame) -> None:
    (seen,) = Variation(NONE, NONE, NONE, np.zeros(LASERS), True).of([frame], np.random.default_rng(1))
    assert np.all(np.diff(seen.azimuth[0].astype(int)) % 36000 < 30)  # it still turns clockwise
    assert np.abs(places(seen)[:, ::-1] - places(frame) * (1, -1, 1)).max() < 1e-3


def test_lasers_that_look_elsewhere_see_what_is_there(frame: Frame) -> None:
    columns = np.arange(LASERS) % 5 - 2
    (seen,) = Variation(NONE, NONE, columns, np.zeros(LASERS), False).of([frame], np.random.default_rng(1))
    row = int(np.flatnonzero(columns[frame.sensor.laser_of_ring] == 2)[0])
    assert np.array_equal(seen.range[row, 2:], frame.range[row, :-2])
    assert not seen.range[row, :2].any()
    apart = np.linalg.norm(places(seen)[row, 2:] - places(frame)[row, :-2], axis=1)
    assert np.median(apart[seen.range[row, 2:] > 0]) < 0.02  # columns are not evenly far apart


def test_noise_is_added_to_returns_and_to_nothing_else(frame: Frame) -> None:
    unit = Variation(NONE, NONE, NONE, np.full(LASERS, 3.0), False)
    (seen,) = unit.of([frame], np.random.default_rng(1))
    assert np.array_equal(seen.range > 0, frame.range > 0)
    moved = (seen.range.astype(int) - frame.range)[frame.range > 10]
    assert 2.9 < moved.std() < 3.1
    (again,) = unit.of([frame], np.random.default_rng(1))
    assert np.array_equal(again.range, seen.range)


def test_a_sensor_of_ones_own_stays_itself() -> None:
    for seed in range(20):
        drawn = Variation.drawn(np.random.default_rng(seed), units=False)
        assert not drawn.level.any()
        assert not drawn.columns.any()
        assert not drawn.noise.any()
    varied = [Variation.drawn(np.random.default_rng(seed), units=True) for seed in range(30)]
    assert any(v.level.any() for v in varied)
    assert any(v.columns.any() for v in varied)
    assert 0 < sum(v.mirrored for v in varied) < 30


@pytest.mark.sweep
def test_simulated_drives_are_the_same_for_a_seed_and_all_different() -> None:
    drives = list(simulated_drives(3, seed=3))
    assert drives[:1] == list(simulated_drives(1, seed=3))
    assert len(set(drives)) == 3
    assert all(drive.startswith(("sim:city?", "sim:road?", "sim:street?")) for drive in drives)


def test_a_clip_has_frames_at_one_distance(frame: Frame) -> None:
    found = list(clips((frame.with_(index=number) for number in range(40)), np.random.default_rng(4)))
    indices = [[frame.index for frame in clip] for clip in found]
    assert indices[0][0] == 0
    assert all(len(clip) == CLIP_FRAMES for clip in indices[:-1])
    assert indices[-1][-1] - indices[-1][0] == len(indices[-1]) - 1
    assert all(len(set(np.diff(clip))) <= 1 for clip in indices)
    assert {int(np.diff(clip)[0]) for clip in indices if len(clip) > 1} > {1}
    assert all(before[-1] < after[0] for before, after in pairwise(indices))
