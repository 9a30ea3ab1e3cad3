"""If these fail, networks learn from labels that are not what the paper means, or hours of annotation are lost."""

from __future__ import annotations

import importlib.util
import json
import shutil
import time
from pathlib import Path

import numpy as np
import pytest

from lidarcodec.api import read_frames
from lidarcodec.errors import MissingExtraError, SettingsError, SourceError, UnknownNameError
from lidarcodec.evaluation.trajectory import Trajectory
from lidarcodec.frame import Frame
from lidarcodec.sources.simulator import SimulatorSource
from lidarcodec.training.annotate import AnnotationSettings, annotate, counted_poses
from lidarcodec.training.annotation_folder import AnnotationFolder, Scans
from lidarcodec.training.ground import Ransac, ground_finder
from lidarcodec.training.labels import GROUND, HIGH, LOW, labels_of, threshold_of
from lidarcodec.training.score_data import labelled
from tests.command_line import run, run_here

pytestmark = pytest.mark.timeout(400)  # seconds of work, minutes on a machine that others use too
FRAMES = 12


def _drive(count: int = FRAMES) -> tuple[list[Frame], SimulatorSource]:
    source = SimulatorSource("street", seed=4, frames=count)
    return list(read_frames(source)), source


@pytest.fixture(scope="module")
def annotated(tmp_path_factory: pytest.TempPathFactory) -> AnnotationFolder:
    frames, source = _drive()
    folder = AnnotationFolder(tmp_path_factory.mktemp("drive") / "annotated")
    annotate(frames, folder, AnnotationSettings("a street", every=2), source.poses)
    return folder


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> AnnotationFolder:
    """Four frames of the same drive."""
    frames, source = _drive(4)
    folder = AnnotationFolder(tmp_path_factory.mktemp("short") / "annotated")
    annotate(frames, folder, AnnotationSettings("a street", every=2), source.poses)
    return folder


def _as_printed(counts: np.ndarray, total: int, share: float) -> int:
    """Algorithm 1 word by word: N_greater is all of them at first, and the loop runs while they are too few."""
    threshold, greater = int(counts.max()), total
    while greater < total * share:
        greater = int((counts > threshold).sum())
        threshold -= 1
    return threshold


def test_the_threshold_is_what_algorithm_1_must_mean_and_not_what_is_printed() -> None:
    counts = np.random.default_rng(2).poisson(9, 4000)
    total, share = 6000, 1 / 12
    found = threshold_of(counts, total, share)
    assert (counts > found).sum() >= total * share > (counts > found + 1).sum()
    printed = _as_printed(counts, total, share)
    assert printed == counts.max()
    assert not (counts > printed).any(), "as printed, nothing is ever selected"


def test_a_scan_with_too_few_returns_beside_the_road_calls_all_of_them_high() -> None:
    assert threshold_of(np.array([3, 0]), 100) == -1
    assert threshold_of(np.array([], np.int64), 100) == -1
    ground = np.array([True] * 98 + [False] * 2)
    assert (labels_of(np.arange(100), ground)[98:] == HIGH).all()


@pytest.mark.sweep
def test_labels_follow_the_truth_of_a_simulated_drive(annotated: AnnotationFolder) -> None:
    """Ground as the scene has it; what moves has been seen from few places, what stands from many."""
    frame, found = annotated.frame(6), annotated.labels(6)
    with SimulatorSource("street", seed=4, frames=FRAMES) as source:
        widths = [one.width for one in read_frames(source)]
        _, _, truth = source.truth(sum(widths) // 6)
    truth = truth[sum(widths[:6]) : sum(widths[:7])].T[frame.sensor.laser_of_ring]
    valid = frame.valid & (truth > 0)
    assert np.array_equal(found.labels > 0, frame.valid)
    road, called = (truth == 1)[valid], (found.labels == GROUND)[valid]
    assert (road & called).sum() / (road | called).sum() > 0.9
    high = (found.labels == HIGH).sum() / frame.valid.sum()
    assert 1 / 12 <= high < 0.3  # twelve frames have few poses, so the next threshold would call too few of them high
    assert found.counts[found.labels == HIGH].min() > found.threshold >= found.counts[found.labels == LOW].max()
    assert found.counts.max() <= FRAMES


@pytest.mark.sweep
def test_a_spot_is_counted_once_a_pose_and_never_more_often_than_there_are_poses(annotated: AnnotationFolder) -> None:
    counts = annotated.map_counts()
    poses = counted_poses(annotated.trajectory().matrices, 0.5).sum()
    assert 3 < poses <= FRAMES
    assert 0 < counts.max() <= poses
    # the same by brute force, for some points of the map
    points, chosen = annotated.map_points().astype(np.float64), np.arange(0, len(counts), max(len(counts) // 40, 1))
    expected = np.zeros(len(chosen), int)
    trajectory, scans = annotated.trajectory(), Scans(annotated)
    from lidarcodec.evaluation.rigid import moved
    from lidarcodec.evaluation.trajectory import deskewed

    for k in np.flatnonzero(counted_poses(trajectory.matrices, 0.5)):
        own = deskewed(scans[k], trajectory.velocities[k])
        world = moved(trajectory.matrices[k], own[np.linalg.norm(own, axis=1) < 80.0])
        for i, m in enumerate(chosen):
            expected[i] += bool((((world - points[m]) ** 2).sum(axis=1) <= 0.1**2).any())
    assert np.array_equal(expected, counts[chosen])


def test_a_standing_car_does_not_count_its_own_waiting() -> None:
    at = np.stack([np.eye(4)] * 6)
    at[:, 0, 3] = [0.0, 0.0, 0.1, 0.6, 0.7, 1.2]
    assert counted_poses(at, 0.5).tolist() == [True, False, False, True, False, True]
    assert counted_poses(at, 0.0).all()


@pytest.mark.sweep
def test_a_run_that_was_stopped_goes_on_and_ends_as_one_that_was_not(
    annotated: AnnotationFolder, tmp_path: Path
) -> None:
    frames, source = _drive()
    folder = AnnotationFolder(tmp_path / "again")

    class StoppedError(Exception):
        pass

    from contextlib import contextmanager

    @contextmanager
    def until_labels(name: str, steps: int):
        if name == "labels":
            raise StoppedError
        yield lambda: None

    settings = AnnotationSettings("a street", every=2, piece=7)
    with pytest.raises(StoppedError):
        annotate(frames, folder, settings, source.poses, stage=until_labels)
    with pytest.raises(SourceError):
        folder.labels(0)
    annotate([], folder, settings, None, workers=2)  # frames and poses are there already
    for k in range(FRAMES):
        mine, other = folder.labels(k), annotated.labels(k)
        assert np.array_equal(mine.counts, other.counts)
        assert np.array_equal(mine.labels, other.labels)
    with pytest.raises(SettingsError, match="every"):
        annotate([], folder, AnnotationSettings("a street", every=3, piece=7))


def test_a_folder_of_something_else_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "letter.txt").write_text("dear")
    frames, source = _drive()
    with pytest.raises(SettingsError, match="has other files"):
        annotate(frames[:2], AnnotationFolder(tmp_path), AnnotationSettings(), source.poses)
    with pytest.raises(SourceError, match="no complete frame"):
        annotate([], AnnotationFolder(tmp_path / "new"), AnnotationSettings(), source.poses)
    with pytest.raises(SourceError):
        _ = AnnotationFolder(tmp_path / "nothing").frames


def test_ransac_finds_a_road_that_tilts_and_none_where_there_is_none() -> None:
    rng = np.random.default_rng(1)
    road = np.c_[rng.uniform(-35, 35, (20000, 2)), np.zeros(20000)]
    road[:, 2] = -1.73 + 0.03 * road[:, 0] + 0.02 * rng.normal(size=20000)
    wall = np.c_[rng.uniform(5, 30, 5000), np.full(5000, 8.0), rng.uniform(-0.5, 3.0, 5000)]
    found = Ransac().ground(np.concatenate([road, wall]))
    assert found[:20000].mean() > 0.97
    assert found[20000:].mean() < 0.03
    assert not Ransac().ground(wall).any()
    assert not Ransac().ground(np.empty((0, 3))).any()


def test_ransac_takes_verges_and_the_crown_of_a_road_for_ground() -> None:
    """With the plane alone near the car they were labelled as things that stand on the road, a sixth of a real drive's
    returns: what is trained on that learns to keep the kerb."""
    rng = np.random.default_rng(2)
    ground = np.c_[rng.uniform(-35, 35, (40000, 2)), np.zeros(40000)]
    ground[:, 2] = -1.73 - 0.004 * ground[:, 1] ** 2 + 0.02 * rng.normal(size=40000)  # 0.2 m lower 7 m aside
    verge = np.abs(ground[:, 1]) > 8
    ground[verge, 2] = -1.73 + 0.25 + 0.02 * rng.normal(size=int(verge.sum()))
    ground = ground[np.abs(ground[:, 1]) < 14]
    parked = np.c_[rng.uniform(6, 12, 4000), rng.uniform(3, 5, 4000), rng.uniform(-1.4, 0.0, 4000)]
    found = Ransac().ground(np.concatenate([ground, parked]))
    assert found[: len(ground)].mean() > 0.95
    assert found[len(ground) :].mean() < 0.15


def test_patchwork_agrees_with_the_plane_on_a_flat_road_and_is_silent(capfd: pytest.CaptureFixture[str]) -> None:
    if importlib.util.find_spec("pypatchworkpp") is None:
        with pytest.raises(MissingExtraError, match="annotate"):
            ground_finder("patchwork")
        pytest.skip("pypatchworkpp is not installed: the extra `annotate`")
    frames, _ = _drive()
    cloud = frames[0].cloud()
    points = np.stack([cloud[axis] for axis in "xyz"], axis=1).astype(np.float64)
    one, other = ground_finder("patchwork").ground(points), ground_finder("ransac").ground(points)
    assert (one & other).sum() / (one | other).sum() > 0.85
    assert capfd.readouterr().out == ""


def test_wrong_settings_are_named() -> None:
    with pytest.raises(SettingsError, match="share"):
        AnnotationSettings(share=1.5)
    with pytest.raises(UnknownNameError, match="ransac"):
        ground_finder("plough")


@pytest.mark.sweep
def test_an_odometry_that_does_not_exist_begins_no_folder(tmp_path: Path) -> None:
    """What was begun with a wrong name would refuse the same command with the right one."""
    out = AnnotationFolder(tmp_path / "drive")
    with pytest.raises(UnknownNameError, match="small_gicp"):
        annotate(_drive()[0][:2], out, AnnotationSettings(odometry="dead reckoning"))
    assert not out.path.exists()


def test_the_command_annotates_by_odometry_and_says_what_it_found(tmp_path: Path) -> None:
    out = tmp_path / "drive"
    done = run("annotate", "sim:street?seed=4", "--frames", "4", "--odometry", "small_gicp", "--every", "1",
                       "--label-every", "2", "--out", str(out), "--json")  # fmt: skip
    assert done.returncode == 0, done.stderr
    about = json.loads(done.stdout)
    assert about["done"]
    assert about["frames"] == 4
    assert sorted(path.name for path in (out / "labels").iterdir()) == ["000000.npz", "000002.npz"]
    assert len(Trajectory.load(out / "trajectory.npz")) == 4
    assert run_here("annotate", "udp://127.0.0.1:0", "--out", str(tmp_path / "live")).returncode == 2


@pytest.mark.sweep
def test_a_folder_is_of_one_capture_whatever_its_name(tmp_path: Path) -> None:
    """Who put another capture, calibration or poses in the place of a wrong one kept the wrong labels."""
    source, out = tmp_path / "drive.pcap", tmp_path / "drive"
    words = ("annotate", source, "--odometry", "small_gicp", "--every", "1", "--out", out)
    for seed, code in ((4, 0), (5, 2)):
        assert run_here("simulate", f"sim:street?seed={seed}", source, "--frames", 3, "--force").returncode == 0
        done = run_here(*words)
        assert done.returncode == code, done.stderr
    assert "another calibration, capture or file of poses" in done.stderr


@pytest.mark.sweep
def test_a_capture_that_grew_is_another_one(tmp_path: Path) -> None:
    """It was still being copied: its first frames are the same, and the labels of the others were missing unsaid."""
    whole, source, out = tmp_path / "whole.pcap", tmp_path / "drive.pcap", tmp_path / "drive"
    words = ("annotate", source, "--odometry", "small_gicp", "--every", "1", "--out", out)
    assert run_here("simulate", "sim:street?seed=4", whole, "--frames", 4).returncode == 0
    source.write_bytes(whole.read_bytes()[: whole.stat().st_size * 5 // 8])
    for beside in tmp_path.glob("whole_*"):
        beside.rename(tmp_path / beside.name.replace("whole", "drive"))
    assert run_here(*words).returncode == 0
    source.write_bytes(whole.read_bytes())
    done = run_here(*words)
    assert done.returncode == 2
    assert "another calibration, capture or file of poses" in done.stderr


@pytest.mark.parametrize("spoiled", ["value", "width", "kind", "count", "frames"])
def test_labels_of_a_stranger_are_refused_in_a_line(tmp_path: Path, short: AnnotationFolder, spoiled: str) -> None:
    """They ended training with errors of torch, or took a minute and more to say nothing."""
    folder = AnnotationFolder(tmp_path / "drive")
    shutil.copytree(short.path, folder.path)
    path = folder.path / "labels" / "000003.npz"
    arrays = dict(np.load(path))
    if spoiled == "value":
        arrays["label"][0, 0] = 4
    elif spoiled == "width":
        arrays |= {name: arrays[name][:, :7] for name in ("count", "label")}
    elif spoiled == "kind":
        arrays["label"] = arrays["label"].astype(float) * np.nan
    elif spoiled == "count":
        arrays["count"] = arrays["count"][:10]
    else:
        folder.note(frames=10**9)
    np.savez(path, **arrays)
    began_s = time.monotonic()
    with pytest.raises(SourceError, match=r"has no labels|of another frame|is not finished"):
        list(labelled([folder.path]))
    assert time.monotonic() - began_s < 60.0
