"""A sensor is found in a map, followed, lost where it is not in the map, and found again; with what certainty."""

import threading

import numpy as np
import pytest

from lidarcodec.commands.localise.progress import Progress
from lidarcodec.errors import SettingsError, SourceError
from lidarcodec.evaluation.rigid import exp_so3, invert, moved
from lidarcodec.evaluation.trajectory import Scan
from lidarcodec.maps.compress import compressed
from lidarcodec.maps.file import MapReader, write_map
from lidarcodec.maps.localise import localiser as localiser_module
from lidarcodec.maps.localise import window as window_module
from lidarcodec.maps.localise.localiser import Localiser
from lidarcodec.maps.localise.search import find_pose
from lidarcodec.maps.localise.tracker import Tracker, sigma_m
from lidarcodec.maps.localise.window import MapWindow
from lidarcodec.maps.points import MapPoints
from tests.maps.towns import court, street, town

TOWN = town(80.0, 20)
RANDOM = np.random.default_rng(11)
TURN_NS = 100_000_000
POINTS = 2000
"""Of a scan."""


def pose_at(x, y, yaw, z=1.8):
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = exp_so3(np.array([0.0, 0.0, yaw])), (x, y, z)
    return pose


def way(number):
    """The pose of a car that drives a bend at 10 m/s."""
    return pose_at(20 + 40 * np.sin(number / 40), 20 + 40 * (1 - np.cos(number / 40)), number / 40)


def scan_at(pose, number, points=TOWN.xyz, most=POINTS):
    """What a sensor at the pose sees, to 60 m, with noise of 1 cm."""
    seen = moved(invert(pose), points)
    seen = seen[np.einsum("ij,ij->i", seen, seen) < 60.0**2]
    seen = seen[RANDOM.permutation(len(seen))[:most]] + RANDOM.normal(0, 0.01, (min(most, len(seen)), 3))
    return Scan(number * TURN_NS, seen.astype(np.float32), np.zeros(len(seen), np.float32))


NOWHERE = Scan(0, RANDOM.uniform(-40, 40, (POINTS, 3)).astype(np.float32), np.zeros(POINTS, np.float32))


def written(path, points):
    with path.open("w+b") as file:
        write_map(file, points)
    return path


@pytest.fixture(scope="module")
def map_file(tmp_path_factory):
    thin, _ = compressed(TOWN, "voxel", len(TOWN) // 4)
    return written(tmp_path_factory.mktemp("map") / "town.lcmap", thin)


@pytest.fixture
def window(map_file):
    with MapReader.open(map_file) as reader:
        yield MapWindow(reader)


def off_m(pose, true):
    return float(np.linalg.norm(pose[:3, 3] - true[:3, 3]))


def test_a_bend_is_followed_to_centimetres_and_the_deviation_says_how_well(window):
    tracker = Tracker(window)
    tracker.propose(way(0) @ pose_at(1.5, -1.5, 0.15, 0.0))
    estimates = [tracker.track(scan_at(way(number), number)) for number in range(10)]
    assert [one.state for one in estimates] == ["searching"] * 2 + ["tracking"] * 8
    assert estimates[1].pose is None
    errors, deviations = [], []
    for number, one in list(enumerate(estimates))[2:]:
        off = one.pose[:3, 3] - way(number)[:3, 3]
        errors.append(np.linalg.norm(off))
        deviations.append(np.sqrt(off @ np.linalg.solve(one.covariance[:3, :3], off) / 3))
    assert max(errors) < 0.05
    assert np.median(deviations) < 3.0
    assert all(sigma_m(one.covariance) < 0.05 for one in estimates[2:])


def test_it_is_found_without_a_hint_lost_outside_of_the_map_and_found_again(map_file):
    with Localiser(map_file) as localiser:
        states = []
        for number in range(16):
            outside = 4 <= number < 10
            scan = NOWHERE._replace(stamp_ns=number * TURN_NS) if outside else scan_at(way(number), number)
            estimate = localiser.take(scan)[-1]
            states.append(estimate.state)
            assert (estimate.pose is None) == (estimate.state != "tracking")
            if not outside and estimate.pose is not None:
                assert off_m(estimate.pose, way(number)) < 0.08
        assert states[2:8] == ["tracking"] * 6  # for four scans the motion leads on
        assert states[8] == "lost"
        assert states[-1] == "tracking"
        assert localiser.tracker.lost_times == 1
        assert localiser.searches >= 2


@pytest.mark.sweep
def test_a_search_in_a_thread_keeps_the_scans_that_come_meanwhile(map_file, monkeypatch):
    with Localiser(map_file, background=True) as localiser:
        assert [one.state for one in localiser.take(scan_at(way(0), 0))] == ["searching"]
        waiting = [localiser.take(scan_at(way(number), number)) for number in (1, 2)]
        assert [len(one) for one in waiting] in ([1, 1], [1, 2], [1, 3])
        localiser._search and localiser._search._thread.join()
        estimates = localiser.take(scan_at(way(3), 3))
        assert estimates[-1].state == "tracking"
        assert [one.stamp_ns for one in estimates] == sorted(one.stamp_ns for one in estimates)
        assert off_m(estimates[-1].pose, way(3)) < 0.08


def test_a_search_that_takes_too_long_is_given_up_and_a_hint_that_fits_ends_one(map_file, monkeypatch):
    monkeypatch.setattr(localiser_module, "find_pose", lambda window, cloud, stop: stop() or wait_for(stop))
    monkeypatch.setattr(localiser_module, "MOST_WAITING", 2)
    with Localiser(map_file, background=True) as localiser:
        for number in range(4):
            localiser.take(scan_at(way(number), number))
        assert localiser.given_up == 1
        localiser.take(scan_at(way(4), 4))
        assert localiser.searches == 2
        localiser.propose(way(5))
        assert [localiser.take(scan_at(way(number), number))[-1].state for number in (5, 6, 7)][-1] == "tracking"
        assert (localiser.searches, localiser.hints, localiser.wrong_hints) == (2, 1, 0)
        assert localiser._search is None


def test_hints_that_are_wrong_neither_end_a_search_nor_are_tried_with_every_scan(map_file, monkeypatch, capsys):
    end = threading.Event()
    monkeypatch.setattr(localiser_module, "find_pose", lambda window, cloud, stop: end.wait(10.0) and None)
    with Localiser(map_file, background=True) as localiser:
        progress = Progress("car/roof", localiser)
        for number in range(30):
            localiser.propose(pose_at(500, 500, 0))
            begun = progress.begin()
            progress.tracked(begun, localiser.take(scan_at(way(number), number, most=300)))
        assert (localiser.searches, localiser.hints, localiser.wrong_hints) == (1, 3, 3)  # after 0, 0.5 and 1.5 s
        assert progress.summary()["wrong_hints"] == 3
        search = localiser._search
        assert search is not None
        end.set()
        search._thread.join()
    assert capsys.readouterr().err.count("do not fit the map") == 1


def wait_for(stop):
    while not stop():
        pass


@pytest.mark.sweep
def test_two_places_that_look_alike_are_none(tmp_path):
    away = TOWN.steps + np.array([round(120 / TOWN.step_m), 0, 0])
    twice = MapPoints(
        TOWN.step_m,
        np.concatenate([TOWN.steps, away]),
        {name: np.concatenate([values, values]) for name, values in TOWN.columns.items()},
    )
    cloud = scan_at(way(9), 0).points.astype(np.float64)
    with MapReader.open(written(tmp_path / "twice.lcmap", twice)) as reader:
        assert find_pose(MapWindow(reader), cloud) is None
        assert find_pose(MapWindow(reader), cloud, stop=lambda: True) is None


@pytest.mark.sweep
def test_a_court_that_looks_the_same_turned_by_180_degrees_has_no_pose(tmp_path):
    there = court(30.0, 17.0)
    cloud = court(30.0, 17.0, seed=2).xyz - [25.0, 25.0, 1.8]
    with MapReader.open(written(tmp_path / "court.lcmap", there)) as reader:
        assert find_pose(MapWindow(reader), cloud[np.abs(cloud[:, :2]).max(axis=1) < 31.0]) is None


def test_a_street_that_looks_the_same_all_along_does_not_say_where_it_is(tmp_path):
    """All of every scan lies in the map, and the standard deviation along the street is what tells."""
    path = written(tmp_path / "street.lcmap", street(200.0, per_m2=2.0).with_columns("normal_a", "normal_b"))
    here, seen = pose_at(100, 0, 0), street(200.0, seed=5, per_m2=2.0).xyz
    with MapReader.open(path) as reader:
        tracker = Tracker(MapWindow(reader))
        tracker.propose(here)
        estimates = [tracker.track(scan_at(here, number, seen)) for number in range(3)]
    assert estimates[0].share > 0.9
    assert [one.state for one in estimates] == ["searching"] * 3


def test_times_that_go_back_are_not_used_and_a_new_drive_begins_anew(window):
    tracker = Tracker(window)
    tracker.propose(way(0))
    states = [tracker.track(scan_at(way(number), number)).state for number in range(4)]
    assert states[-1] == "tracking"
    assert tracker.track(scan_at(way(3), 2)).pose is None  # of 0.1 s ago
    assert tracker.track(scan_at(way(4), 4)).pose is not None
    assert tracker.track(scan_at(way(4), 400)).state == "lost"
    assert tracker.track(scan_at(way(4), -400)).state == "lost"


def test_empty_and_tiny_scans_are_taken(window):
    tracker = Tracker(window)
    for points in (0, 1, 49):
        assert tracker.track(scan_at(way(0), points, most=points)).state == "searching"
    assert find_pose(window, np.empty((0, 3))) is None
    tracker.propose(way(0))
    for number in range(4):
        tracker.track(scan_at(way(number), number + 100))
    assert tracker.track(scan_at(way(4), 104, most=0)).state == "tracking"


def test_a_start_outside_of_the_map_is_refused(map_file):
    with Localiser(map_file) as localiser:
        with pytest.raises(SettingsError, match="no points within"):
            localiser.start(5000.0, 0.0, 0.0)
        localiser.start(23.0, 20.0, 5.0)
        found = [localiser.take(scan_at(way(number), number))[-1] for number in range(3)][-1]
        assert found.state == "tracking"
        assert off_m(found.pose, way(2)) < 0.1
        assert localiser.searches == 0


def test_only_tiles_around_are_read_and_damaged_ones_are_reported_and_left_out(tmp_path, caplog, monkeypatch):
    count = 40
    places = np.stack([np.arange(count) * 50 + 25, np.zeros(count), np.zeros(count)], axis=1)
    steps = np.rint((places[:, None] + RANDOM.uniform(-20, 20, (count, 60, 3))).reshape(-1, 3) / 0.02).astype(np.int64)
    path = written(tmp_path / "long.lcmap", MapPoints(0.02, np.unique(steps, axis=0)))
    with MapReader.open(path) as reader:
        window = MapWindow(reader)
        for x in (25.0, 500.0, 1000.0):
            assert window.around(np.array([x, 0.0, 0.0])) is not None
            assert len(window._tiles) <= 2 * 6
        assert window.around(np.array([9000.0, 0.0, 0.0])) is None
        hurt = next(place for place in reader.places if place.x == 20)
    data = bytearray(path.read_bytes())
    data[hurt.offset + 6] ^= 1
    path.write_bytes(data)
    with MapReader.open(path) as reader:
        window = MapWindow(reader)
        for _ in range(2):
            assert window.around(np.array([1000.0, 0.0, 0.0])) is not None
            window.around(np.array([0.0, 0.0, 0.0]))
        assert window.damaged == {hurt}
        assert caplog.text.count("cannot be read and is left out") == 1
        monkeypatch.setattr(window_module, "MOST_POINTS", 100)
        with pytest.raises(SourceError, match="map compress"):
            window.around(np.array([300.0, 0.0, 0.0]))
