"""Every job of the table on a small archive, and policies."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import duckdb
import numpy as np
import pytest

from lidarcodec.archive import tasks
from lidarcodec.archive.archive import open_archive
from lidarcodec.archive.contents import commits_of
from lidarcodec.archive.jobs.table import JOBS
from lidarcodec.archive.names import Commit, id_of
from lidarcodec.archive.policy import Policy
from lidarcodec.archive.query import query, segments_where
from lidarcodec.archive.squares import MapPlan
from lidarcodec.archive.stores.folder import FolderStore
from lidarcodec.archive.table import duckdb_errors
from lidarcodec.cloud import second_returns
from lidarcodec.commands.archive.run import _made
from lidarcodec.errors import SettingsError, SourceError
from lidarcodec.maps.file import read_map
from lidarcodec.sources import open_source
from tests.archive.conftest import unchanged
from tests.archive.test_archive import FRAMES, SHORT, archive, objects, payloads
from tests.command_line import run_here

HERE = ("--workers", "here")
SCENE = "sim:city?sensor=vlp16&frames=13"


@pytest.fixture(scope="module")
def drives(tmp_path_factory) -> Path:
    """A folder with a short simulated recording of car-7/roof, with poses."""
    folder = tmp_path_factory.mktemp("posed")
    path = folder / "car-7" / "roof" / "drive.mcap"
    path.parent.mkdir(parents=True)
    with open_source(SCENE) as source:
        start = next(iter(source.packets())).stamp_ns
        stamps = np.arange(start, start + 2 * 10**9, 10**8)
        np.savez(folder / "poses.npz", T_world_velo=np.stack([source.poses.at(int(stamp)) for stamp in stamps]),
                 velo_mid=stamps * 1e-9, stamps_ns=stamps)  # fmt: skip
    done = run_here("encode", SCENE, str(path), "--codec", "zstd", "--poses", str(folder / "poses.npz"))
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture(scope="module")
def made(drives, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("made") / "out"
    archive("run", drives, out, *SHORT)
    return out


@pytest.fixture
def filled(made, tmp_path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "out"))


def test_the_jobs_are_those_that_are_promised():
    assert set(JOBS) == {"compress", "recompress", "reduce", "verify", "convert", "map", "index", "stats"}


@pytest.mark.parametrize(
    ("form", "names"),
    [("pcap", 1), ("pcd", None), ("rosbag", 2), *(pytest.param(form, names, marks=pytest.mark.sweep)
     for form, names in (("npz", 1), ("ply", None), ("kitti", None), ("laz", 1)))],
)  # fmt: skip
def test_convert_writes_each_segment_once(drives, filled, tmp_path, form, names):
    if form == "laz":
        pytest.importorskip("lazrs", reason="needs the extra las")
    out, words = tmp_path / "converted", ("--job", "convert", "--as", form, *HERE, "--json")
    told = json.loads(archive("run", filled, out, *words).stdout)
    assert (told["segments"], told["frames"]) == (2, FRAMES)
    notes = sorted(out.rglob("*-*.json"))
    files = [[out / name for name in json.loads(note.read_text())["files"]] for note in notes]
    assert all(path.stat().st_size for paths in files for path in paths)
    assert [len(paths) for paths in files] == [names] * 2 if names else sum(map(len, files)) == FRAMES + 2
    if form in ("pcap", "rosbag"):
        back = [payload for paths in files for payload in payloads(paths[0] if form == "pcap" else paths[0].parent)]
        assert back == payloads(drives / "car-7/roof/drive.mcap")
    with unchanged(out):
        assert json.loads(archive("run", filled, out, *words).stdout)["finished"] == 2


@pytest.mark.data
def test_converted_points_tell_the_second_returns_that_they_lack(data_file, tmp_path):
    """Points of a month of a dual-return sensor would lack half of its returns without a word."""
    name, drive = "OS-0-32-U1_v2.2.0_1024x10", tmp_path / "in" / "car-7" / "roof"
    drive.mkdir(parents=True)
    for ending in ("pcap.xz", "json"):
        shutil.copy2(data_file(f"sensors/ouster/{name}.{ending}"), drive)
    archive("run", tmp_path / "in", tmp_path / "out", *HERE)
    words = ("--job", "convert", "--as", "ply", *HERE, "--json")
    told = json.loads(archive("run", tmp_path / "out", tmp_path / "points", *words).stdout)
    lacking = sum(second_returns(frame) for frame in open_archive(tmp_path / "out").frames())
    assert told["second_returns_left_out"] == lacking > 100


@pytest.mark.sweep
def test_reduce_keeps_the_settings_of_each_segment(filled):
    words = (
        "run",
        filled,
        filled,
        "--job",
        "reduce",
        "--set",
        "reduction=random",
        "--set",
        "keep_fraction=0.25",
        *HERE,
    )
    before = open_archive(filled).query("select sum(points) from frames")[1][0][0]
    assert json.loads(archive(*words, "--json").stdout)["segments"] == 2
    ((after, codecs, bound),) = open_archive(filled).query(
        "select sum(points), count(distinct codec), max(bound_m) from frames"
    )[1]
    assert after == pytest.approx(before / 4, rel=0.02)
    assert (codecs, bound) == (1, 0.0)
    assert json.loads(archive(*words, "--json").stdout)["unchanged"] == 2


@pytest.mark.sweep
def test_the_same_reduction_with_another_bound_removes_nothing_more(filled):
    points, words = "select sum(points) from frames", ("run", filled, filled, "--job", "recompress", *HERE, "--json")
    reduced = ("--set", "reduction=random", "--set", "keep_fraction=0.5")
    archive(*words, *reduced)
    before = open_archive(filled).query(points)
    coarser = (*words, *reduced, "--set", "max_error_m=0.05")
    assert json.loads(archive(*coarser).stdout)["segments"] == 2
    assert open_archive(filled).query(points) == before
    assert json.loads(archive(*coarser).stdout)["unchanged"] == 2
    archive(*words, "--set", "reduction=random", "--set", "keep_fraction=0.25")
    assert open_archive(filled).query(points) < before


def test_stats_say_what_is_there(filled):
    done = archive("run", filled, filled, "--job", "stats", "--json")
    (row,) = json.loads(done.stdout)["stats"]
    assert (row["vehicle"], row["sensor"], row["codec"], row["frames"]) == ("car-7", "roof", "pcodec", FRAMES)
    assert "2 segments, 13 frames" in archive("run", filled, filled, "--job", "stats").stdout


@pytest.mark.sweep
def test_errors_of_several_codings_add_up(filled):
    exact = [frame.range.astype(int) for frame in open_archive(filled).frames()]
    for bound in ("0.02", "0.05"):
        archive("run", filled, filled, "--job", "recompress", "--set", f"max_error_m={bound}", *HERE)
    frames = list(open_archive(filled).frames())
    found = max(int(np.abs(frame.range - old).max()) for frame, old in zip(frames, exact, strict=True))
    ((bound, error),) = open_archive(filled).query("select max(bound_m), max(error_m) from frames")[1]
    step = frames[0].sensor.range_step_m
    assert 0.05 < found * step <= error + 1e-9 <= bound + 2e-9 <= 0.07 + 3e-9
    assert "within 7 cm" in archive("run", filled, filled, "--job", "stats").stdout


@pytest.mark.sweep
def test_a_map_is_made_of_the_squares_that_were_seen(filled, tmp_path):
    out = tmp_path / "maps"
    told = json.loads(archive("run", filled, out, "--job", "map", *HERE, "--json").stdout)
    assert told["inputs"] >= 1
    assert told["points"] > 100
    assert open_archive(filled).query("select count(x) from frames")[1] == [(FRAMES,)]
    maps = [read_map(path) for path in sorted((out / "maps").glob("*.lcmap"))]
    assert sum(map(len, maps)) == told["points"]
    with unchanged(out):
        archive("run", filled, out, "--job", "map", *HERE)


def test_no_map_is_made_without_drives_that_were_replaced_meanwhile(filled, monkeypatch):
    """The listing of commits and the query do not see the same archive."""
    store = FolderStore(filled)
    squares = len(list(MapPlan(store, store).tasks()))
    assert squares >= 1
    replaced = Commit("car-7", "roof", 1, 1, commits_of(store)[0].segment, id_of("new"))

    def before_a_commit(*words):
        found = query(*words)
        store.create(replaced.name, b"{}")
        return found

    monkeypatch.setattr("lidarcodec.archive.squares.query", before_a_commit)
    plan = MapPlan(store, store)
    assert list(plan.tasks()) == []
    assert plan.counts == {"inputs": squares, "unfinished": squares, "lost": 0}
    assert "changed while they were listed" in plan.remarks()[0]


def test_squares_beyond_the_limit_are_reported(filled, monkeypatch):
    monkeypatch.setattr("lidarcodec.archive.squares.MAX_SQUARES", 0)
    plan = MapPlan(FolderStore(filled), FolderStore(filled))
    assert list(plan.tasks()) == []
    assert (plan.counts["unfinished"], plan.remarks()[0].partition(":")[0]) == (1, "there are more than 0 squares")


def test_frames_that_fit_a_condition_are_whole_when_a_segment_is_replaced(filled, monkeypatch):
    asked = []

    def before_a_recompress(*words):
        found = segments_where(*words)
        if not asked:
            archive("run", filled, filled, "--job", "recompress", "--codec", "zstd", *HERE)
        asked.append(words)
        return found

    monkeypatch.setattr("lidarcodec.archive.query.segments_where", before_a_recompress)
    assert len(list(open_archive(filled).frames(where="true"))) == FRAMES
    assert len(asked) == 2
    monkeypatch.setattr("lidarcodec.archive.query.segments_where", lambda *_: ({id_of("gone"): {0}}, 0))
    with pytest.raises(SourceError, match="try again later"):
        list(open_archive(filled).frames(where="true"))


POLICY = """
[[rule]]
after_days = 30
set = { max_error_m = 0.02 }
[[rule]]
after_days = 365
vehicle = "car-*"
codec = "zstd"
set = { max_error_m = 0.05 }
"""


def test_a_policy_takes_the_rule_with_the_most_days(tmp_path):
    path = tmp_path / "policy.toml"
    path.write_text(POLICY)
    day = 86_400 * 10**9
    policy = Policy.of(path, 1000 * day, _made)

    def settings(vehicle: str, age: float):
        stamp = int((1000 - age) * day)
        found = policy.settings_for(Commit(vehicle, "roof", stamp, stamp, id_of(1), id_of(2)))
        return found and (found["codec"], found["max_error_m"])

    assert [settings("car-7", age) for age in (29, 31, 366)] == [None, ("pcodec", 0.02), ("zstd", 0.05)]
    assert settings("van-1", 366) == ("pcodec", 0.02)


@pytest.mark.parametrize(
    "text",
    ["", "rule = 1", "[[rule]]", "[[rule]]\nafter_days = -1\ncodec = 'zstd'", "[[rule]]\nafter_days = true",
     "[[rule]]\nafter_days = 1", "[[rule]]\nafter_days = 1\ncodec = 5", "[[rule]]\nafter_days = nan\ncodec='zstd'",
     "[[rule]]\nafter_days = 1\nset = { nothing = 1 }", "[[rule]]\nafter_days = 1\ncodec='zstd'\nmore = 1",
     "\x00", "[" * 9999],
)  # fmt: skip
def test_a_wrong_policy_is_refused_before_anything_is_done(tmp_path, text):
    path = tmp_path / "policy.toml"
    path.write_text(text)
    with pytest.raises(SettingsError):
        Policy.of(path, 0, _made)


def test_a_policy_thins_out_and_deletes_only_when_told(filled, tmp_path):
    (path := tmp_path / "policy.toml").write_text("[[rule]]\nafter_days = 0\ncodec = 'raw'")
    words = ("run", filled, filled, "--job", "recompress", "--policy", path, *HERE)
    with unchanged(filled):
        told = json.loads(archive(*words, "--dry-run", "--delete-old", "--json").stdout)
    assert told["segments"] == 2
    before = objects(filled)
    archive(*words)
    assert objects(filled).items() >= before.items()
    archive(*words, "--delete-old")
    assert len(list((filled / "recordings").rglob("*.mcap"))) == 2
    assert open_archive(filled).query("select distinct codec, bound_m <= 0.05 from frames")[1] == [("raw", True)]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--job", "convert"), "--as NAME"),
        (("--job", "convert", "--as", "nothing"), "unknown format"),
        (("--job", "reduce", "--set", "max_error_m=0.1"), "--job reduce takes"),
        (("--job", "stats", "--as", "pcd"), "--as is only for --job convert"),
        (("--job", "recompress", "--policy", "p", "--codec", "zstd"), "or --policy"),
        (("--job", "map", "--repair"), "--repair works only on an archive, but --job map"),
    ],
)
def test_wrong_options_are_refused(tmp_path, words, said):
    done = run_here("archive", "run", str(tmp_path / "in"), str(tmp_path / "out"), *words)
    assert done.returncode == 2
    assert said in done.stderr


def test_a_task_that_lacks_memory_for_its_query_is_tried_again_and_not_set_aside(tmp_path, monkeypatch):
    def lacking(value, source, target):
        with duckdb_errors(), duckdb.connect(config={"memory_limit": "1MB", "temp_directory": ""}) as connection:
            return connection.execute("select list(range) from range(10000000)").fetchall()

    monkeypatch.setattr(tasks, "work_of", lambda kind: lacking)
    ended = tasks.work(tasks.Task("stats", "key", "label", str(tmp_path), str(tmp_path)))
    assert (ended.how, "more memory" in ended.why) == ("store", True)
