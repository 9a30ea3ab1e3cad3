"""If these fail, `voxel-seen` of another sensor than an HDL-64E drops what stands, or keeps what moves."""

from __future__ import annotations

import numpy as np
import pytest

from lidarcodec import _native
from lidarcodec.motion.warp import beam_rows
from lidarcodec.pipeline import frames_of
from lidarcodec.reduction.base import Budget
from lidarcodec.reduction.ground import ground_of
from lidarcodec.reduction.spread import returns_of
from lidarcodec.reduction.stand_in import StandIn
from lidarcodec.reduction.voxel_seen import VoxelSeen
from lidarcodec.sources import open_source
from tests.contracts import frames as made
from tests.sweeps import sampled

TURNS = 11


def test_the_ground_is_that_of_an_hdl64e() -> None:
    frame = made.scene(400)
    returns = returns_of(frame)
    points = (returns.xyz / 16_000).astype(np.float32)
    fired = frame.fired.view(np.uint8)
    native = _native.ground_of(points, returns.cells, frame.azimuth, fired, beam_rows(frame.sensor))
    assert np.mean(ground_of(points) != native) < 0.005
    assert not ground_of(np.zeros((0, 3), np.float32)).size


@pytest.mark.parametrize("sensor", sampled(["vlp16", "xt32", "os1-128"], ["vlp16"]))
def test_a_car_that_drives_is_placed_without_poses_and_its_own_roof_is_left_out(sensor: str) -> None:
    reducer, first, placed = VoxelSeen(Budget(fraction=0.25)), None, 0
    with open_source(f"sim:city?sensor={sensor}&seed=3&frames={TURNS}") as source:
        for frame in frames_of(source.packets(), source.sensor):
            reduced = reducer.reduce(frame.with_(pose=None))
            assert reduced.keep is not None
            assert int(reduced.valid.sum()) == int(0.25 * frame.points + 0.5)
            first = first or frame
            placed += reducer.report()["odometry"] == "found"
    assert placed >= TURNS - 2
    report = reducer.report()
    assert report["seen_before"]
    assert 0 < report["unseen"] < 0.2 * frame.points
    moved = reducer._scans[-1].T_world_sensor[:3, 3]
    if frame.pose is not None and first.pose is not None:
        true = (np.linalg.inv(first.pose) @ frame.pose)[:3, 3]
        assert np.linalg.norm(moved - true) < 0.1 * np.linalg.norm(true) + 0.05
    assert 2.0 < moved[0] < 10.0


def test_a_stand_in_has_the_points_of_its_sensor() -> None:
    with open_source("sim:city?sensor=vlp16&seed=3&frames=2") as source:
        frame = next(iter(frames_of(source.packets(), source.sensor)))
    like = StandIn().of(frame)
    assert like is not None
    given, came = frame.cloud(), like.cloud()
    assert len(came) == len(given)
    off = [np.abs(given[axis] - came[axis]) for axis in "xyz"]
    assert max(float(np.percentile(one, 99)) for one in off) < 0.15
