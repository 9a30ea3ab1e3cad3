"""Drives are put into one map where they overlap, to centimetres. What does not overlap is refused, and not guessed."""

import numpy as np
import pytest

from lidarcodec.errors import SourceError
from lidarcodec.evaluation.rigid import exp_so3, invert, log_so3, moved
from lidarcodec.maps import align
from lidarcodec.maps.align import Sample, WeakOverlapError, aligned, samples_of
from lidarcodec.maps.file import MapReader, write_map
from lidarcodec.maps.localise.window import MapWindow
from tests.maps.towns import street, town

TOWN = town(80.0, 20)
OTHER = town(80.0, 20, seed=9)
RANDOM = np.random.default_rng(4)


def moved_by(x, y, z, yaw_deg):
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = exp_so3(np.array([0.0, 0.0, np.radians(yaw_deg)])), (x, y, z)
    return found


PATH = np.stack([np.arange(20.0, 60.0), np.full(40, 42.0), np.full(40, 1.8)], axis=1)
T_MAP_DRIVE = moved_by(30.0, -12.0, 2.5, 130.0)


def drive(points, way, T_map_drive=T_MAP_DRIVE, drift=None):
    """Samples of a drive, in its own frame. way: (F, 2) places in the map; drift: of each pose, (4, 4)"""
    found = []
    for number, (x, y) in enumerate(way):
        place = np.array([x, y, 1.8])
        seen = points.xyz - place
        seen = seen[np.einsum("ij,ij->i", seen, seen) < 60.0**2]
        seen = seen[RANDOM.permutation(len(seen))[:1500]] + place + RANDOM.normal(0, 0.01, (min(len(seen), 1500), 3))
        back = invert(T_map_drive) if drift is None else drift[number] @ invert(T_map_drive)
        there = moved(back, place[None])[0]
        yaw_deg = np.degrees(np.arctan2(back[1, 0], back[0, 0]))
        found.append(Sample(moved(back, seen) - there, there, yaw_deg))
    return found


def straight(count=7, length_m=24.0, x=25.0):
    return np.stack([np.linspace(x, x + length_m, count), np.full(count, 40.0)], axis=1)


def error_of(found, true=T_MAP_DRIVE):
    off = found.transform @ invert(true)
    middle = np.array([[40.0, 40.0, 1.8]])
    return float(np.linalg.norm(moved(off, middle) - middle)), np.degrees(np.linalg.norm(log_so3(off[None, :3, :3])[0]))


@pytest.fixture(scope="module")
def window(tmp_path_factory):
    path = tmp_path_factory.mktemp("map") / "town.lcmap"
    with path.open("w+b") as file:
        write_map(file, TOWN)
    with MapReader.open(path) as reader:
        yield MapWindow(reader)


def test_a_drive_is_found_turned_and_moved_by_any_amount(window):
    found = aligned(window, PATH, drive(TOWN, straight()))
    metres, degrees = error_of(found)
    assert metres < 0.1
    assert degrees < 0.2
    assert (found.scans, found.of, found.overlap) == (7, 7, 1.0)
    assert found.residual_m < 0.05
    assert found.residual_deg < 0.1


def test_what_lies_beyond_the_map_does_not_speak_against_a_drive(window, monkeypatch):
    """A drive that leaves the map sees it from afar, and its last scans do not fit."""
    monkeypatch.setattr(align, "_searched", lambda *_: T_MAP_DRIVE)
    found = aligned(window, PATH[:25], drive(TOWN, straight(13, 60.0)))
    assert error_of(found)[0] < 0.1
    assert found.scans == found.of == 6
    assert found.overlap == 6 / 13


def test_a_drive_through_another_town_is_refused(window, monkeypatch):
    monkeypatch.setattr(align, "MOST_SEARCHED", 2)
    with pytest.raises(WeakOverlapError, match="of 2 of its scans"):
        aligned(window, PATH, drive(OTHER, straight()))


def test_a_wrong_place_that_a_search_believes_in_is_refused_by_the_other_scans(window, monkeypatch):
    """As where two streets look alike: the search is sure, and the scans beside it are not where it leads to."""
    monkeypatch.setattr(align, "_searched", lambda *_: T_MAP_DRIVE @ moved_by(8.0, 3.0, 0.0, 15.0))
    with pytest.raises(WeakOverlapError, match="scans that lie in their map fit it"):
        aligned(window, PATH, drive(TOWN, straight()))
    monkeypatch.setattr(align, "_searched", lambda *_: T_MAP_DRIVE)
    with pytest.raises(WeakOverlapError, match="of 7 scans that lie in their map fit it"):
        aligned(window, PATH, drive(OTHER, straight()))


def test_poses_that_bend_are_refused(window, monkeypatch):
    """A rigid alignment would double the walls."""
    drift = [moved_by(0.0, 0.3 * number - 0.9, 0.0, 0.0) for number in range(7)]
    monkeypatch.setattr(align, "_searched", lambda *_: T_MAP_DRIVE)
    with pytest.raises(WeakOverlapError, match=r"bend apart by 0\.5"):
        aligned(window, PATH, drive(TOWN, straight(), drift=drift))


def test_a_start_replaces_the_search_if_the_first_scan_fits_there(window, monkeypatch):
    monkeypatch.setattr(align, "_searched", None)
    found = aligned(window, PATH, drive(TOWN, straight()), (27.0, 38.5, 10.0))
    assert error_of(found)[0] < 0.1
    with pytest.raises(WeakOverlapError, match="fit"):
        aligned(window, PATH, drive(TOWN, straight()), (60.0, 60.0, 90.0))


def test_a_street_that_looks_the_same_all_along_is_no_overlap(tmp_path, monkeypatch):
    path = tmp_path / "street.lcmap"
    with path.open("w+b") as file:
        write_map(file, street(200.0, per_m2=2.0).with_columns("normal_a", "normal_b"))
    monkeypatch.setattr(align, "MOST_SEARCHED", 2)
    way = np.stack([np.linspace(80, 104, 6), np.zeros(6)], axis=1)
    with MapReader.open(path) as reader, pytest.raises(WeakOverlapError):
        aligned(MapWindow(reader), reader.path.astype(float), drive(street(200.0, seed=5, per_m2=2.0), way))


def test_samples_are_spread_over_the_way_and_bounded():
    poses = [moved_by(0.5 * number, 0.0, 0.0, 0.0) for number in range(400)]
    cloud = RANDOM.uniform(-5, 5, (10, 3))
    found = samples_of([(cloud + pose[:3, 3], pose) for pose in poses])
    places = np.array([sample.place[0] for sample in found])
    assert 48 <= len(found) <= align.MOST_SAMPLES
    assert np.diff(places).min() >= 4.0
    assert places[-1] > 190
    standing = samples_of([(cloud, np.eye(4))] * 30)
    assert len(standing) == 1
    with pytest.raises(SourceError, match="less than 10 m"):
        aligned(None, PATH, standing)
