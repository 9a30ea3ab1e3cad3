"""Points that are moved to where maps are lie there to the millimetre: 32 bits are half a metre apart in UTM."""

from __future__ import annotations

import csv
import resource
from pathlib import Path

import numpy as np
import pytest

from lidarcodec.commands.outputs.base import NARROW
from lidarcodec.commands.outputs.ply import PlyOutput
from lidarcodec.commands.outputs.table import FORMS
from lidarcodec.commands.selection.points import Placing
from lidarcodec.errors import SettingsError
from tests.apps.past.kept_drive import frames
from tests.command_line import run_here, the_one_line

SOURCE = "sim:street?frames=1&traffic=0&sensor=vlp16"
EAST, NORTH, UP = 456114.587, 5427629.217, 115.0


def csv_of(path: Path) -> np.ndarray:
    with path.open() as file:
        return np.array([[float(row[name]) for name in ("x_m", "y_m", "z_m")] for row in csv.DictReader(file)])


@pytest.fixture(scope="module")
def there(tmp_path_factory: pytest.TempPathFactory) -> np.ndarray:
    """Where the points are to lie, in metres."""
    path = tmp_path_factory.mktemp("near") / "near.csv"
    assert run_here("convert", SOURCE, path).returncode == 0
    return csv_of(path) @ np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]]) + (EAST, NORTH, UP)


def far(path: Path) -> object:
    return run_here("convert", SOURCE, path, "--transform", f"{EAST},{NORTH},{UP},0,0,90")


def read(path: Path) -> np.ndarray:
    if path.suffix == ".csv":
        return csv_of(path)
    if path.suffix == ".ply":
        data = path.read_bytes()
        fields = [(name, "<f8" if name in ("x", "y", "z") else NARROW[name].str) for name in NARROW.names or ()]
        rows = np.frombuffer(data[data.index(b"end_header\n") + 11 :], np.dtype(fields))
        return np.stack([rows[axis] for axis in "xyz"], axis=1)
    if path.suffix == ".e57":
        scan = pytest.importorskip("pye57").E57(str(path)).read_scan(0, ignore_missing_fields=True)
        return np.stack([scan[f"cartesian{axis}"] for axis in "XYZ"], axis=1)
    rows = pytest.importorskip("laspy").read(path)
    return np.stack([rows.x, rows.y, rows.z], axis=1)


@pytest.mark.parametrize(("ending", "error_m"), [("csv", 2e-4), ("ply", 2e-4), ("las", 7e-4), ("e57", 2e-4)])
def test_points_in_utm_are_where_they_are(tmp_path: Path, there: np.ndarray, ending: str, error_m: float) -> None:
    if ending in ("las", "e57"):
        pytest.importorskip({"las": "laspy", "e57": "pye57"}[ending])
    path = tmp_path / f"far.{ending}"
    assert far(path).returncode == 0
    assert np.abs(read(path) - there).max() < error_m


@pytest.mark.parametrize("name", ["far.pcd", "scans"])
def test_formats_of_32_bits_are_refused_rather_than_blurred(tmp_path: Path, name: str) -> None:
    words = ("--as", "kitti") if name == "scans" else ()
    done = run_here("convert", SOURCE, tmp_path / name, *words, "--transform", f"{EAST},{NORTH},{UP},0,0,90")
    assert done.returncode == 2
    assert "0.5 m apart there: write .ply" in the_one_line(done)
    assert list(tmp_path.iterdir()) == []


def test_what_is_moved_a_little_is_as_before(tmp_path: Path) -> None:
    path = tmp_path / "near.ply"
    assert run_here("convert", SOURCE, path, "--transform", "10,0,0,0,0,90").returncode == 0
    assert b"property float x\n" in path.read_bytes()[:400]


def test_merged_points_are_refused_where_poses_jump_to_another_place(tmp_path: Path) -> None:
    """Poses that begin at zero, before a receiver knows where it is, and go on in UTM."""
    placing = Placing(merge=True)
    (frame,) = frames(1)
    near, away = np.eye(4), np.eye(4)
    away[0, 3] = NORTH
    output = PlyOutput(tmp_path / "far.ply")
    output.write(frame, placing.points(frame.with_(pose=near)))
    with pytest.raises(SettingsError, match=r"0\.5 m apart there: write \.las"):
        output.write(frame, placing.points(frame.with_(pose=away)))
    output.close()


@pytest.mark.parametrize("ending", ["e57", "laz"])
def test_a_full_disk_is_an_error_of_the_disk_whatever_the_library_calls_it(tmp_path: Path, ending: str) -> None:
    """`unexpected E57Exception` sounds as if the program were broken, and says nothing of the disk."""
    pytest.importorskip({"e57": "pye57", "laz": "lazrs"}[ending])
    (frame,) = frames(1)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (5_000, limits[1]))
    try:
        with pytest.raises(OSError, match=r"write\(\) failed|Failed to call write|File too large"):  # noqa: PT012
            output = FORMS[ending].open(tmp_path / f"full.{ending}")
            output.write(frame, frame.cloud())
            output.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
