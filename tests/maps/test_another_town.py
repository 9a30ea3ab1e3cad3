"""A start in another town, or at another place of this one: there the ground fits, and nothing else."""

import numpy as np
import pytest

from lidarcodec.maps.localise.localiser import Localiser
from lidarcodec.maps.points import packed_normals
from tests.maps.test_localise import TOWN, off_m, pose_at, scan_at, way, written
from tests.maps.towns import town


@pytest.fixture(scope="module")
def map_file(tmp_path_factory):
    return written(tmp_path_factory.mktemp("map") / "town.lcmap", TOWN)


def states(localiser, points, poses):
    return [localiser.take(scan_at(pose, number, points))[-1].state for number, pose in enumerate(poses)]


def test_a_start_given_in_another_town_gives_no_pose(map_file):
    elsewhere = town(80.0, 20, seed=8).xyz
    with Localiser(map_file) as localiser:
        localiser.start(20.0, 20.0, 0.0)
        assert set(states(localiser, elsewhere, map(way, range(6)))) == {"searching"}


def test_banks_that_fit_in_another_town_are_not_enough(tmp_path):
    """Every second strip of the ground is a metre higher, here as there: only walls say which town it is."""
    both = [town(80.0, 20, seed=seed) for seed in (3, 8)]
    for points in both:
        ground = (points.xyz[:, 2] < 0.1) & (points.xyz[:, 0] // 8 % 2 == 1)
        points.steps[ground, 2] += 50
    path = written(tmp_path / "banks.lcmap", both[0])
    for points, known in zip(both, (True, False), strict=True):
        with Localiser(path) as localiser:
            localiser.start(20.0, 20.0, 0.0)
            assert ("tracking" in states(localiser, points.xyz, map(way, range(6)))) is known


def test_odometry_of_another_world_gives_no_pose(map_file):
    elsewhere = town(80.0, 20, seed=9).xyz
    with Localiser(map_file) as localiser:
        for number in range(6):
            localiser.propose(way(number))
            assert localiser.take(scan_at(way(number), number, elsewhere))[-1].state == "searching"
        assert localiser.hints == localiser.wrong_hints > 0


@pytest.mark.parametrize("start", [(25.0, 20.0, 5.0), (20.0, 25.0, 5.0), (16.0, 20.0, -10.0), (45.0, 50.0, 90.0)])
def test_a_start_that_leads_beside_the_place_gives_no_wrong_pose(map_file, start):
    with Localiser(map_file) as localiser:
        localiser.start(*start)
        found = [localiser.take(scan_at(way(number), number))[-1].pose for number in range(8)]
        assert found[-1] is not None
        assert all(pose is None or off_m(pose, way(at)) < 0.1 for at, pose in enumerate(found))


def test_an_open_road_with_its_traffic_is_found(tmp_path):
    """A few posts, seen among cars that were not there when the map was made."""
    random = np.random.default_rng(2)
    flat = TOWN.xyz[TOWN.xyz[:, 2] < 0.1]
    walls = TOWN.xyz[TOWN.xyz[:, 2] > 0.1]
    posts = walls[random.permutation(len(walls))[: len(flat) // 12]]
    cars = random.uniform((0, 0, 0.3), (80, 80, 1.5), (len(flat) // 30, 3))
    chosen = np.flatnonzero((TOWN.xyz[:, 2] < 0.1) | np.isin(TOWN.xyz, posts).all(axis=1))
    path = written(tmp_path / "road.lcmap", TOWN.taken(chosen))
    with Localiser(path) as localiser:
        localiser.start(20.0, 20.0, 0.0)
        seen = np.concatenate([flat, posts, cars])
        assert states(localiser, seen, [pose_at(20 + number, 20, 0) for number in range(4)])[-1] == "tracking"


@pytest.mark.parametrize("seed", [0, 2])
def test_on_an_open_road_at_30_m_s_it_is_where_it_is(tmp_path, seed):
    """It was `tracking` at the place of the start, good to centimetres, while the vehicle went on: 20 m off."""
    flat, walls = (TOWN.xyz[side] for side in (TOWN.xyz[:, 2] < 0.1, TOWN.xyz[:, 2] > 0.1))
    posts = walls[np.random.default_rng(seed).permutation(len(walls))[: len(flat) // 20]]
    chosen = np.flatnonzero((TOWN.xyz[:, 2] < 0.1) | np.isin(TOWN.xyz, posts).all(axis=1))
    path = written(tmp_path / "road.lcmap", TOWN.taken(chosen))
    with Localiser(path) as localiser:
        localiser.start(15.0, 20.0, 0.0)
        for number in range(8):
            pose = pose_at(15 + 3 * number, 20, 0)
            found = localiser.take(scan_at(pose, number, np.concatenate([flat, posts])))[-1].pose
            assert found is None or off_m(found, pose) < 0.1
    assert found is not None


def test_ground_alone_tells_no_place(tmp_path):
    """Its bumps passed for certainty along the road: a pose good to centimetres, anywhere."""
    ground = town(80.0, 0, seed=3)
    up = np.random.default_rng(1).normal((0, 0, 1), (0.05, 0.05, 0), (len(ground), 3))
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    ground.columns.update(zip(("normal_a", "normal_b"), packed_normals(up), strict=True))
    path = written(tmp_path / "plain.lcmap", ground)
    with Localiser(path) as localiser:
        localiser.start(20.0, 20.0, 0.0)
        poses = [pose_at(20 + number, 20, 0) for number in range(5)]
        assert set(states(localiser, ground.xyz, poses)) == {"searching"}
