"""`voxel-seen`: a localiser is misled by the cars around it, and only by them; nothing that stands may go with them."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pytest

from lidarcodec import api, open_source
from lidarcodec.frame import Frame
from lidarcodec.pipeline import frames_of
from lidarcodec.reduction import make_reducer
from lidarcodec.reduction.base import Reducer
from lidarcodec.reduction.odometry import Odometry
from lidarcodec.reduction.spread import LENGTHS_PER_M, returns_of
from lidarcodec.settings import StreamSettings
from lidarcodec.sources.posed import with_poses

TURN_NS = 100_000_000


def reducer(**budget: object) -> Reducer:
    return make_reducer(StreamSettings(reduction="voxel-seen", **(budget or {"keep_points": 9000})))


def road_with(poses: bool, framing: str = "revolution", frames: int = 16, scene: str = "road") -> list[Frame]:
    with open_source(f"sim:{scene}?frames={frames}") as source:
        return list(with_poses(frames_of(source.packets(), source.sensor, framing), source.poses if poses else None))


@pytest.fixture(scope="module")
def road() -> list[Frame]:
    """With poses; a car 10 m ahead, others beside and behind, guard rails 11 m to each side."""
    return road_with(poses=True)


def kept_of(frame: Frame) -> tuple[int, int]:
    """Returns that stay on the carriageway and above it (cars), and on the guard rails. The road lies at -1.7 m."""
    x, y, z = (returns_of(frame).xyz / LENGTHS_PER_M).T
    ahead = (np.abs(x) < 38) & (z > -1.2)
    return int((ahead & (np.abs(y) < 6) & (np.abs(x) > 4)).sum()), int((ahead & (np.abs(y) > 9)).sum())


def last_of(reducing: Reducer, frames: Iterable[Frame]) -> Frame:
    for frame in frames:
        reduced = reducing.reduce(frame)
    return reduced


def test_cars_go_and_what_stands_stays(road: list[Frame]) -> None:
    cars, rails = kept_of(last_of(make_reducer(StreamSettings(reduction="voxel", keep_points=9000)), road))
    assert cars > 50
    assert rails > 50
    for frames in (road, [frame.with_(pose=None) for frame in road], road[1::2]):
        reducing = reducer()
        left = kept_of(last_of(reducing, frames))
        assert left[0] < 0.1 * cars
        assert left[1] > 0.9 * rails
        assert reducing.report()["seen_before"]


@pytest.mark.sweep
def test_slabs_are_looked_up_in_the_slabs_of_a_turn() -> None:
    slabs = road_with(poses=True, framing="packets:29")
    reducing, whole = reducer(keep_fraction=0.09), make_reducer(StreamSettings(reduction="voxel", keep_fraction=0.09))
    kept = [reducing.reduce(slab) for slab in slabs]
    plain = [whole.reduce(slab) for slab in slabs]
    assert [frame.valid.sum() for frame in kept] == [frame.valid.sum() for frame in plain]
    cars, rails = np.sum([kept_of(frame) for frame in kept[-12:]], axis=0)
    cars_of_all, rails_of_all = np.sum([kept_of(frame) for frame in plain[-12:]], axis=0)
    assert cars < 0.2 * cars_of_all
    assert rails > 0.9 * rails_of_all


@pytest.mark.sweep
def test_slabs_without_poses_are_looked_up_too() -> None:
    """Twice a turn a motion is found; the slabs between go on as the vehicle went."""
    reducing = reducer(keep_fraction=0.09)
    slabs = road_with(poses=False, framing="packets:29")
    kept, kinds = [], []
    for slab in slabs:
        kept.append(reducing.reduce(slab))
        kinds.append(reducing.report()["odometry"])
    assert set(kinds[24:]) == {"found", "carried"}
    assert reducing.report()["seen_before"]
    cars, rails = np.sum([kept_of(frame) for frame in kept[-12:]], axis=0)
    plain = make_reducer(StreamSettings(reduction="voxel", keep_fraction=0.09))
    cars_of_all, rails_of_all = np.sum([kept_of(plain.reduce(slab)) for slab in slabs][-12:], axis=0)
    assert cars < 0.2 * cars_of_all
    assert rails > 0.9 * rails_of_all


def test_the_part_of_a_turn_that_a_recording_ends_with_is_looked_up(road: list[Frame]) -> None:
    """A third of a turn says nothing of its motion: cars in it still go."""
    reducing = reducer(keep_fraction=0.09)
    last_of(reducing, [frame.with_(pose=None) for frame in road[:-1]])
    third = np.arange(road[-1].width) < road[-1].width // 3
    part = road[-1].with_(pose=None, keep=np.ones((64, 1), np.bool_) & third)
    cars, _ = kept_of(reducing.reduce(part))
    plain, _ = kept_of(make_reducer(StreamSettings(reduction="voxel", keep_fraction=0.09)).reduce(part))
    assert reducing.report()["seen_before"]
    assert cars <= 0.2 * plain


def test_without_a_motion_for_long_it_is_voxel(road: list[Frame]) -> None:
    """Past 0.3 s without a motion nothing may be dropped on its word: fog, a tunnel, a hand on the sensor."""
    reducing = reducer()
    last_of(reducing, [frame.with_(pose=None) for frame in road])
    noise = np.random.default_rng(3).integers(1000, 20000, road[0].range.shape).astype(np.uint16)
    kinds = []
    for index in range(16, 22):
        frame = road[0].with_(
            index=index, stamp_ns=road[-1].stamp_ns + (index - 15) * TURN_NS, pose=None, range=noise, keep=None
        )
        assert reducing.reduce(frame).valid.sum() == 9000
        kinds.append(reducing.report()["odometry"])
    assert kinds == ["carried"] * 3 + ["unknown"] * 3
    assert not reducing.report()["seen_before"]
    assert reducing.report()["unseen"] == 0


def test_it_is_voxel_until_there_is_something_to_look_at(road: list[Frame]) -> None:
    reducing, plain = reducer(), make_reducer(StreamSettings(reduction="voxel", keep_points=9000))
    for frame in road[:7]:
        np.testing.assert_array_equal(reducing.reduce(frame).valid, plain.reduce(frame).valid)
        assert not reducing.report()["seen_before"]
    last_of(reducing, road[7:])
    assert reducing.report()["seen_before"]


def test_a_pause_or_a_clock_that_was_set_begins_anew(road: list[Frame]) -> None:
    for jump_ns in (5_000_000_000, -1_000_000_000):
        reducing = reducer()
        last_of(reducing, road)
        reducing.reduce(road[-1].with_(stamp_ns=road[-1].stamp_ns + jump_ns))
        assert not reducing.report()["seen_before"]


@pytest.mark.parametrize("pose", [None, np.eye(4)])
def test_at_standstill_everything_is_seen_again(road: list[Frame], pose: np.ndarray | None) -> None:
    reducing, plain = reducer(), make_reducer(StreamSettings(reduction="voxel", keep_points=9000))
    for index in range(14):
        frame = road[0].with_(index=index, stamp_ns=road[0].stamp_ns + index * TURN_NS, pose=pose)
        np.testing.assert_array_equal(reducing.reduce(frame).valid, plain.reduce(frame).valid)
    assert reducing.report()["seen_before"]
    assert reducing.report()["unseen"] == 0


def test_the_budget_is_kept_even_if_it_takes_what_was_not_seen(road: list[Frame]) -> None:
    reducing = reducer(keep_points=102_000)
    reduced = last_of(reducing, road)
    assert reducing.report()["unseen"] > 1500
    assert reduced.valid.sum() == 102_000


def test_poses_that_cannot_be_are_not_believed(road: list[Frame]) -> None:
    """Nothing is dropped on the word of poses that jump, or that are no numbers."""
    wild = [np.full((4, 4), np.nan), np.eye(4) * 1e300, np.diag([1.0, 1, 1, 0])]
    far = [np.eye(4) + np.pad([[500.0 * index]], ((0, 3), (3, 0))) for index in range(12)]
    for poses in (far, wild * 4):
        reducing = reducer()
        frames = [frame.with_(pose=pose) for frame, pose in zip(road, poses, strict=False)]
        assert last_of(reducing, frames).valid.sum() == 9000
        assert reducing.report()["odometry"] in ("unknown", "found")


@pytest.mark.sweep
def test_odometry_on_board_knows_the_way_of_a_second() -> None:
    """Within a hand's breadth after 0.9 s, or whatever stands would be taken for moving. On a bare road it is off by
    decimetres: little there says how far the car went along it."""
    frames = road_with(poses=True, frames=14, scene="street")
    odometry = Odometry()
    places = [odometry.next(frame.with_(pose=None)) for frame in frames]
    assert [place.kind for place in places[:2]] == ["unknown", "found"]
    moved = np.linalg.inv(places[4].T_world_sensor) @ places[13].T_world_sensor
    truth = np.linalg.inv(frames[4].pose) @ frames[13].pose
    assert np.linalg.norm(truth[:3, 3]) > 5
    assert np.linalg.norm(moved[:3, 3] - truth[:3, 3]) < 0.15


def test_a_real_drive_keeps_its_budget_with_and_without_poses(data_file) -> None:
    frames = list(api.read_frames(data_file("kitti_tracking0006_f000-010.pcap.xz")))
    reducing = reducer(keep_points=4500)
    kinds = []
    for frame in frames:
        assert reducing.reduce(frame).valid.sum() == min(4500, frame.points)
        kinds.append(reducing.report()["odometry"])
    assert kinds == ["unknown", *["found"] * (len(frames) - 1)]
