"""What stands beside a road says where along it a sensor is. Where it says nothing, or something else, no pose is
claimed: neither at a start, nor later."""

import numpy as np
import pytest

from lidarcodec.maps.localise.evidence import seen_from, weigh
from lidarcodec.maps.localise.localiser import Localiser
from lidarcodec.maps.localise.tracker import sigma_m
from lidarcodec.maps.world import MapWorld
from tests.maps import test_localise
from tests.maps.test_localise import off_m, pose_at, scan_at, written
from tests.maps.towns import open_road

ROAD = open_road()
AHEAD = np.array([1.0, 0.0, 0.0])
SPEED_M = 2.0
"""A scan, at 20 m/s."""


@pytest.fixture(scope="module")
def here(tmp_path_factory):
    return written(tmp_path_factory.mktemp("road") / "road.lcmap", ROAD)


def at(number, jump_m=0.0):
    return pose_at(60 + SPEED_M * number + jump_m, 20, 0)


def claimed(localiser, poses, points=ROAD.xyz, most=4000, first=0):
    """The error and the standard deviation of each pose that is claimed; None where none is."""
    found = []
    for number, pose in enumerate(poses, first):
        one = localiser.take(scan_at(pose, number, points, most))[-1]
        found.append(None if one.pose is None else (off_m(one.pose, pose), sigma_m(one.covariance)))
    return found


def wrong(found):
    return [one for one in found if one is not None and one[0] > max(0.5, 4 * one[1])]


def test_a_place_three_metres_along_the_road_has_nothing_that_speaks_for_it():
    """The ground and the rails lie in the map at both."""
    world = MapWorld(ROAD)
    cloud = scan_at(at(3), 0, ROAD.xyz, 4000).points.astype(float)
    right, beside = (weigh(world, seen_from(cloud, pose), pose, AHEAD) for pose in (at(3), at(3, 3.0)))
    assert right.lead > 100
    assert beside.lead < 0
    assert right.share > 0.8
    assert beside.share < 0.1


def test_the_ground_and_rails_do_not_say_how_far_along_the_road_one_is():
    """The bumps of the ground did, to a centimetre."""
    bare = open_road(posts=0)
    cloud = scan_at(at(3), 0, bare.xyz, 4000).points.astype(float)
    assert sigma_m(MapWorld(bare).fit(cloud, at(3), ()).covariance) > 0.3


@pytest.mark.parametrize("start", [56.0, 63.0, 64.0])
@pytest.mark.parametrize("most", [4000, 800])
def test_a_start_metres_off_along_the_road_leads_to_the_place_or_to_none(here, start, most):
    """Of thin scans, too, in which little stands: they were tracked metres off, said to be good to centimetres."""
    with Localiser(here) as localiser:
        localiser.start(start, 20.0, 0.0)
        found = claimed(localiser, [at(number) for number in range(9)], most=most)
    assert not wrong(found)
    assert most < 4000 or found[-1] is not None


@pytest.mark.parametrize("seed", [2, 3])
def test_another_road_with_other_posts_gives_no_pose(here, seed):
    """Its ground and its rails are those of this one."""
    with Localiser(here) as localiser:
        localiser.start(60.0, 20.0, 0.0)
        assert not any(claimed(localiser, [at(number) for number in range(8)], open_road(seed=seed).xyz))


@pytest.mark.parametrize("seed", [0, 2])
def test_a_sensor_that_comes_to_an_unknown_stretch_is_said_to_be_lost(here, monkeypatch, seed):
    """Posts that are not in the map: the ground fitted on, and so did every speed."""
    monkeypatch.setattr(test_localise, "RANDOM", np.random.default_rng(seed))
    changed = open_road(seed=4).xyz
    with Localiser(here) as localiser:
        localiser.start(60.0, 20.0, 0.0)
        assert claimed(localiser, [at(number) for number in range(6)])[-1] is not None
        for number in range(6, 16):
            last = localiser.take(scan_at(at(number), number, changed, 4000))[-1]
        assert last.state == "lost"


@pytest.mark.parametrize("seed", [13, 14])
def test_a_few_posts_that_agree_by_chance_are_no_place(here, monkeypatch, seed):
    """A sixth of them did, 11 m beside: it was tracked there, three scans after it had been lost."""
    monkeypatch.setattr(test_localise, "RANDOM", np.random.default_rng(seed))
    moved = open_road(seed=seed).xyz
    with Localiser(here) as localiser:
        localiser.start(60.0, 20.0, 0.0)
        claimed(localiser, [at(number) for number in range(6)])
        found = claimed(localiser, [at(number) for number in range(6, 18)], moved, first=6)
    assert not wrong(found)


def test_a_pose_is_as_far_off_as_its_deviation_says(here):
    with Localiser(here) as localiser:
        localiser.start(60.0, 20.0, 0.0)
        found = [one for one in claimed(localiser, [at(number) for number in range(12)], most=2000) if one]
    assert len(found) > 6
    assert max(error / sigma for error, sigma in found) < 4
