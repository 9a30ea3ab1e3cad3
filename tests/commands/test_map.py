"""`map build`, `compress`, `info` and `export` from end to end."""

import json
import signal

import numpy as np
import pytest

from lidarcodec.commands.map.build import Asked
from lidarcodec.errors import SettingsError
from lidarcodec.evaluation.rigid import exp_so3, invert, log_so3, moved
from lidarcodec.maps.build import MapBuilder
from lidarcodec.maps.file import read_map
from lidarcodec.maps.kept_build import KeptBuild
from lidarcodec.sources import open_source
from tests.command_line import run_here, start, the_one_line
from tests.transport.test_contract import eventually

SOURCE = "sim:street?frames=5&traffic=0"


def printed(*words):
    ran = run_here("map", *words, "--json")
    assert ran.returncode == 0, ran.stderr
    return json.loads(ran.stdout)


@pytest.fixture(scope="module")
def town(tmp_path_factory):
    out = tmp_path_factory.mktemp("map") / "town.lcmap"
    made = printed("build", SOURCE, "-o", out, "--least-seen", 2)
    assert made["points"] == len(read_map(out)) > 5000
    assert made["bytes"] == out.stat().st_size
    return out


def test_a_map_is_compressed_described_and_exported(town, tmp_path):
    twenty, five = printed("compress", town, "-o", tmp_path / "s.lcmap", "--keep", "20%,5%")
    assert twenty["output"] == str(tmp_path / "s-20.lcmap")
    assert twenty["bytes"] > five["bytes"]
    (fitted,) = printed("compress", town, "-o", tmp_path / "b.lcmap", "--bytes", 4000, "--by", "voxel", "--no-normals")
    assert 3700 <= fitted["bytes"] == (tmp_path / "b.lcmap").stat().st_size <= 4000
    found = printed("info", tmp_path / "s-5.lcmap")
    assert (found["points"], found["frame"], found["columns"]) == (five["points"], "local", ["normal_a", "normal_b"])
    for ending, before in ((".pcd", b"DATA binary\n"), (".ply", b"end_header\n")):
        out = tmp_path / f"s{ending}"
        assert printed("export", tmp_path / "s-5.lcmap", out)["points"] == five["points"]
        rows = out.read_bytes().partition(before)[2]
        assert len(rows) == five["points"] * (24 if ending == ".pcd" else 36)


@pytest.mark.sweep
def test_a_map_in_utm_is_the_local_one_turned_and_moved(town, tmp_path):
    out = tmp_path / "utm.lcmap"
    printed("build", SOURCE, "-o", out, "--least-seen", 2, "--origin", "49.0,8.4,90")
    local, utm = read_map(town), read_map(out)
    assert utm.frame.zone == 32
    assert np.abs(np.median(utm.xyz, axis=0) - np.median(local.xyz, axis=0) - [456114.59, 5427629.21, 0]).max() < 1.5


@pytest.mark.parametrize(
    ("words", "named", "code"),
    [
        (["build", SOURCE, "sim:city?frames=2", "-o", "a.lcmap", "--poses", "p.npz"], "--poses once for each", 2),
        (["build", SOURCE, "-o", "a.pcd"], ".lcmap", 2),
        (["build", "sim:street", "-o", "a.lcmap"], "--frames", 2),
        (["build", SOURCE, "-o", "a.lcmap", "--origin", "north"], "LAT,LON,HEADING", 2),
        (["build", SOURCE, "sim:city?frames=2", "-o", "a.lcmap", "--start", "a,b,c"], "X,Y,YAW", 2),
        (["build", SOURCE, "sim:city?frames=2", "-o", "a.lcmap", "--start", "1,2,3", "--start", "1,2,3"], "starts", 2),
        (["compress", "a.lcmap", "-o", "b.lcmap"], "--keep", 2),
        (["compress", "a.lcmap", "-o", "b.lcmap", "--keep", "5"], "20%,5%", 2),
        (["compress", "a.lcmap", "-o", "b.lcmap", "--keep", "5%", "--by", "learned"], "learned", 2),
        (["info", "a.lcmap"], "a.lcmap", 1),
        (["export", "a.lcmap", "a.obj"], ".pcd", 2),
    ],
)
def test_what_cannot_be_is_refused_in_one_line_and_leaves_nothing(words, named, code, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    ran = run_here("map", *words)
    assert ran.returncode == code
    assert named in the_one_line(ran)
    assert list(tmp_path.iterdir()) == []


def test_a_drive_that_does_not_overlap_enough_is_refused_and_named(tmp_path):
    capture = tmp_path / "street.pcap"
    assert run_here("simulate", SOURCE, capture).returncode == 0
    ran = run_here("map", "build", SOURCE, capture, "-o", tmp_path / "a.lcmap")
    assert ran.returncode == 1
    line = the_one_line(ran)
    assert f"{capture} cannot be aligned with the drives before it: it leads over less than 10 m" in line
    assert "--poses" in line
    assert not (tmp_path / "a.lcmap").exists()


@pytest.mark.sweep
def test_drives_in_opposite_directions_without_common_poses_are_aligned(tmp_path):
    """Twice the same street of a town: the poses of the second drive are turned and moved."""
    there, back = (f"sim:city?seed=3&traffic=0&frames=30&skip={skip}" for skip in (405, 1105))
    T_world_own = np.eye(4)
    T_world_own[:3, :3], T_world_own[:3, 3] = exp_so3(np.array([0.0, 0.0, 1.3])), (35.0, -20.0, 1.5)
    files = []
    for source, transform in ((there, np.eye(4)), (back, T_world_own)):
        with open_source(source) as opened:
            first = next(iter(opened.packets())).stamp_ns
            stamps = first + np.arange(-2, 170) * 20_000_000
            poses = invert(transform) @ np.stack([opened.poses.at(int(stamp)) for stamp in stamps])
        files.append(tmp_path / f"{len(files)}.npz")
        np.savez(files[-1], T_world_sensor=poses, stamps=stamps * 1e-9)
    words = ("build", there, back, "-o", tmp_path / "a.lcmap", "--poses", files[0], "--poses", files[1], "--align")
    made = printed(*words, "--every", 2)
    (found,) = made["aligned"]
    off = np.array(found["transform"]) @ invert(T_world_own)
    places = opened.poses(stamps)[:, :3, 3]
    assert np.linalg.norm(moved(off, places) - places, axis=1).max() < 0.1
    assert found["source"] == back
    assert found["scans"] == found["of"] >= 10
    assert found["residual_m"] < 0.05
    assert np.degrees(np.linalg.norm(log_so3(off[None, :3, :3]))) < 0.2


def test_a_step_that_does_not_divide_a_tile_is_refused_before_any_work(tmp_path):
    """Tiles of the file would lie elsewhere than those of the drive: points vanished, and others moved by metres."""
    done = run_here("map", "build", SOURCE, "-o", tmp_path / "a.lcmap", "--step", 0.03)
    assert done.returncode == 2
    assert "divides 50 m" in the_one_line(done)


def test_shares_that_would_have_one_name_are_refused(town, tmp_path):
    done = run_here("map", "compress", town, "-o", tmp_path / "a.lcmap", "--keep", "50%,50.0%")
    assert done.returncode == 2
    assert "give each share only once" in the_one_line(done)
    assert not list(tmp_path.iterdir())


def test_the_solver_prints_nothing_between_the_results(town, tmp_path):
    pytest.importorskip("highspy", reason="needs the extra `maps`")
    (found,) = printed("compress", town, "-o", tmp_path / "a.lcmap", "--keep", "5%", "--by", "paper")
    assert found["by"] == "paper"
    assert 0 <= found["gap"] < 0.01
    assert found["seconds"] >= 0


@pytest.mark.sweep
def test_points_in_utm_keep_their_places_in_a_pcd(tmp_path):
    """Northings are millions of metres: 32 bits would move them by a quarter of a metre."""
    out = tmp_path / "u.lcmap"
    printed("build", SOURCE, "-o", out, "--least-seen", 2, "--origin=49.01,8.43,90")
    printed("export", out, tmp_path / "u.pcd")
    head, _, rows = (tmp_path / "u.pcd").read_bytes().partition(b"DATA binary\n")
    assert b"SIZE 8 8 8 4 4 4" in head
    kinds = [("x", "<f8"), ("y", "<f8"), ("z", "<f8"), ("a", "<f4"), ("b", "<f4"), ("c", "<f4")]
    found = np.frombuffer(rows, kinds)
    assert np.abs(np.stack([found[axis] for axis in "xyz"], axis=1) - read_map(out).xyz).max() < 1e-6


@pytest.mark.sweep
def test_a_build_that_was_stopped_goes_on_and_makes_the_same_map(tmp_path):
    words = ["map", "build", "sim:street?frames=12&traffic=0", "-o", tmp_path / "street.lcmap", "--least-seen", 2]
    with start(*words) as process:
        assert eventually((tmp_path / "street.lcmap.building").exists)
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "run the same command again" in said
    assert (tmp_path / "street.lcmap.building" / "kept.json").exists()
    again = run_here(*words)
    assert again.returncode == 0, again.stderr
    assert "going on with" in again.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["street.lcmap"]
    words[4] = tmp_path / "at-once.lcmap"
    assert run_here(*words).returncode == 0
    assert (tmp_path / "at-once.lcmap").read_bytes() == (tmp_path / "street.lcmap").read_bytes()


@pytest.mark.parametrize("changes", ["mounts.yaml", "drive_db.xml", "drive.json", "drive.pcap"])
def test_a_build_does_not_go_on_with_other_inputs(tmp_path, changes):
    """One half of the map had the old mounting or calibration, and the other half the new one."""
    for name in ("mounts.yaml", "drive_db.xml", "drive.json", "drive.pcap"):
        (tmp_path / name).write_bytes(b"before")
    asked = Asked(
        [str(tmp_path / "drive.pcap")], tmp_path / "town.lcmap", poses=[], origin=None, step_m=0.02, least_seen=2,
        every=1, frames=None, skip=0, calibration=None, mounts=[f"{tmp_path / 'mounts.yaml'}#roof"],
    )  # fmt: skip
    (tmp_path / "building").mkdir()
    kept = KeptBuild(tmp_path / "building", asked.decides())
    kept.save(MapBuilder(tmp_path / "building", 20_000))
    assert KeptBuild(tmp_path / "building", asked.decides()).saved, "nothing has changed"
    (tmp_path / changes).write_bytes(b"and after")
    with pytest.raises(SettingsError, match="a build of other drives"):
        KeptBuild(tmp_path / "building", asked.decides())
