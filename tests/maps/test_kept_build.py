"""The build of a map that was ended goes on where it was, and makes the same bytes."""

import json
from io import BytesIO

import numpy as np
import pytest

from lidarcodec.errors import SettingsError, SourceError
from lidarcodec.evaluation.trajectory import Trajectory
from lidarcodec.maps import cells
from lidarcodec.maps.build import MapBuilder
from lidarcodec.maps.drives import DriveSpec
from lidarcodec.maps.joining import Joining
from lidarcodec.maps.kept_build import KeptBuild
from tests.sweeps import sampled

STEP_UM = 20_000
DRIVES = [DriveSpec("sim:street?frames=5&traffic=0"), DriveSpec("sim:street?frames=4&traffic=0&seed=1")]


class EndedError(Exception):
    """The program ended here."""


def build(folder, passing, *, save_at=(), end_at=None):
    """The bytes of the map, and what was kept. save_at: scans after which it is saved; end_at: after which it ends"""
    kept = KeptBuild(folder, {"drives": 2})
    builder = MapBuilder(folder, STEP_UM, least_seen=2)
    kept.go_on(builder)

    def tick():
        if builder.scans in save_at:
            kept.save(builder)
        if builder.scans == end_at:
            raise EndedError

    Joining(builder, np.eye(4), passing, kept, tick).add(DRIVES, align=False, starts=[None, None])
    builder.write(file := BytesIO())
    return file.getvalue(), kept


@pytest.mark.parametrize(("saved", "ended"), sampled([(2, 2), (3, 4), (5, 5), (4, 7), (9, 9)], [(4, 7)]))
def test_it_makes_the_same_bytes_as_one_that_was_not_ended(tmp_path, monkeypatch, saved, ended):
    """Also where tiles were put away after the last time it was saved, as when it is killed."""
    monkeypatch.setattr(cells, "NEAR_M", 30.0)
    monkeypatch.setattr(cells, "GATHER_EVERY", 2)
    for name in ("whole", "ended", "passing"):
        (tmp_path / name).mkdir()
    wanted, kept = build(tmp_path / "whole", tmp_path / "passing", save_at={1, 4, 6})
    kept.clear()
    assert list((tmp_path / "whole").iterdir()) == []
    with pytest.raises(EndedError):
        build(tmp_path / "ended", tmp_path / "passing", save_at={1, saved}, end_at=ended)
    again, kept = build(tmp_path / "ended", tmp_path / "passing", save_at={8})
    assert kept.scans == saved
    assert again == wanted


def test_what_was_found_is_not_found_again(tmp_path):
    found = Trajectory(np.array([1, 2]), np.stack([np.eye(4)] * 2), np.zeros((2, 6)))
    KeptBuild(tmp_path, {}).keep_trajectory(3, found)
    kept = KeptBuild(tmp_path, {})
    assert kept.saved
    np.testing.assert_array_equal(kept.trajectory(3).matrices, found.matrices)
    assert kept.trajectory(2) is None


def test_another_build_is_refused_unless_it_is_to_be_given_up(tmp_path):
    (tmp_path / "mine.txt").write_text("not of a build")
    builder = MapBuilder(tmp_path, STEP_UM)
    KeptBuild(tmp_path, {"step": 1}).save(builder)
    with pytest.raises(SettingsError, match="--force"):
        KeptBuild(tmp_path, {"step": 2})
    assert KeptBuild(tmp_path, {"step": 2}, force=True).scans == 0
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


@pytest.mark.parametrize("damage", [b"", b"{", b"[]", b'{"wanted": {}}', b'{"wanted": {}, "builder": 3, "begun": 4}'])
def test_a_damaged_folder_is_named_and_never_half_believed(tmp_path, damage):
    KeptBuild(tmp_path, {}).save(MapBuilder(tmp_path, STEP_UM))
    (tmp_path / "kept.json").write_bytes(damage)
    with pytest.raises((SourceError, SettingsError), match=r"cannot be read|other drives"):
        KeptBuild(tmp_path, {})


@pytest.mark.parametrize(
    "part",
    [
        {"arrays": "../mine.npz"},
        {"found": {"0": "../mine.npz"}},
        {"builder": {"far": [[0, 0, "../mine.npz"]]}},
        {"builder": {"far": [[0, 0, "../0_0-0.npz"]]}},
        {"builder": [1]},
        {"builder": {"scans": "x"}},
        {"begun": [{"number": 0, "scans": -5}]},
        {"begun": [{"number": 0, "alignment": "zz"}]},
    ],
    ids=str,
)
def test_a_state_that_no_build_wrote_is_refused_and_removes_no_other_file(tmp_path, part):
    """A file that it named as its own, anywhere, was removed once the build went on."""
    folder = tmp_path / "town.lcmap.building"
    folder.mkdir()
    KeptBuild(folder, {}).save(MapBuilder(folder, STEP_UM))
    (folder / "state-0.npz").rename(tmp_path / "mine.npz")
    state = json.loads((folder / "kept.json").read_text())
    (folder / "kept.json").write_text(json.dumps(state | part))
    with pytest.raises(SourceError, match=r"cannot be read .*delete it"):
        KeptBuild(folder, {})
    assert (tmp_path / "mine.npz").exists()


@pytest.mark.parametrize("damaged", [lambda data: data[:-9], lambda data: data.replace(b"path", b"haps")])
def test_damaged_arrays_are_named(tmp_path, damaged):
    """A disk that lost a part of them ended the command with `unexpected BadZipFile`."""
    KeptBuild(tmp_path, {}).save(MapBuilder(tmp_path, STEP_UM))
    there = tmp_path / "state-0.npz"
    there.write_bytes(damaged(there.read_bytes()))
    with pytest.raises(SourceError, match="delete it"):
        KeptBuild(tmp_path, {}).go_on(MapBuilder(tmp_path, STEP_UM))


def test_a_state_with_more_drives_than_there_are_is_refused(tmp_path):
    kept = KeptBuild(tmp_path, {})
    kept.begin(2, None)
    with pytest.raises(SourceError, match="more drives"):
        kept.begun(2)
