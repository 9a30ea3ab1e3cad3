"""If these fail, a network cannot be trained for the sensor that a team has, or learns from points that are off."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from lidarcodec.api import read_frames
from lidarcodec.errors import SourceError
from lidarcodec.evaluation.localisation.drive import read_drive
from lidarcodec.evaluation.trajectory import scan_of
from lidarcodec.frame import Frame
from lidarcodec.sensors.clouds.message import ROS1
from lidarcodec.sources import open_source
from lidarcodec.training.annotate import AnnotationSettings, annotate
from lidarcodec.training.annotation_folder import AnnotationFolder
from lidarcodec.training.labels import GROUND, HIGH
from lidarcodec.training.score_data import SELDOM_M, example_of, labelled
from tests.command_line import run_here, the_one_line
from tests.point_clouds import message, ros1, velodyne
from tests.sources.test_cloud_bags import bag1
from tests.sweeps import sampled

SENSORS = sampled(["vlp16", "xt32", "os1-128"], ["vlp16"])
FRAMES = 7


@pytest.fixture(scope="module", params=SENSORS)
def drive(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Frame], Path]:
    """Frames of a drive in which the car moves, and the folder in which they are annotated."""
    with open_source(f"sim:street?seed=4&sensor={request.param}&frames={FRAMES}") as source:
        frames, poses = list(read_frames(source)), source.poses
    folder = AnnotationFolder(tmp_path_factory.mktemp(request.param) / "labels")
    annotate(frames, folder, AnnotationSettings("a street", every=2, label_every=3), poses)
    return frames, folder.path


def test_frames_come_back_with_their_points_and_times(drive: tuple[list[Frame], Path]) -> None:
    frames, path = drive
    folder = AnnotationFolder(path)
    assert folder.sensor.hash == frames[0].sensor.hash
    for k in (0, FRAMES - 1):
        given, came = scan_of(frames[k]), folder.scan(k)
        assert came.stamp_ns == given.stamp_ns
        np.testing.assert_array_equal(came.points, given.points)
        np.testing.assert_allclose(came.after_s, given.after_s, atol=1e-8)
        np.testing.assert_array_equal(folder.frame(k).range, frames[k].range)
        np.testing.assert_array_equal(folder.frame(k).intensity, frames[k].intensity)


def test_every_return_has_a_label_and_the_road_is_ground(drive: tuple[list[Frame], Path]) -> None:
    _, path = drive
    for frame, found in labelled([path]):
        assert np.array_equal(found.labels > 0, frame.valid)
        assert (found.labels == HIGH).any()
        cloud, ground = frame.cloud(), found.labels.T[frame.valid.T] == GROUND
        near = np.hypot(cloud["x"], cloud["y"]) < 15
        low = cloud["z"] < -1.3
        assert (ground & low & near).sum() > 0.8 * ((ground | low) & near).sum()
        example = example_of(frame, found, np.random.default_rng(1))
        rows, columns = example.label.shape
        assert rows % 8 == columns % 16 == 0
        assert rows >= frame.sensor.rows
        metres = np.expm1(2 * (example.features[0].astype(np.float32) + 1))
        assert metres[example.seldom >= 0].min() > 0.99 * SELDOM_M[0], "the car itself is in no map"


def test_a_damaged_folder_is_refused_in_a_sentence(drive: tuple[list[Frame], Path], tmp_path: Path) -> None:
    _, path = drive
    about = json.loads((path / "annotation.json").read_text())
    for change in ({"model": "hdl65"}, {"model": "pointcloud2"}, {"range_step_m": "1"}, {"description": 5}):
        (tmp_path / "annotation.json").write_text(json.dumps(about | {"sensor": about["sensor"] | change}))
        with pytest.raises(SourceError, match="does not describe the sensor"):
            _ = AnnotationFolder(tmp_path).sensor
    folder, sensor = AnnotationFolder(tmp_path), AnnotationFolder(path).sensor
    file = dict(np.load(path / "frames/000000.npz"))
    one = next(name for name in file if name.startswith("series."))
    (tmp_path / "frames").mkdir()
    for change in (
        {one: file[one][:-1]},
        {one: file[one].astype(np.float64)},
        {"layout": np.frombuffer(b"none", np.uint8)},
        {"packet_ns": file["packet_ns"][:-1]},
        {"range": file["range"][:, :-1]},
    ):
        np.savez(tmp_path / "frames/000000.npz", **(file | change))
        with pytest.raises(SourceError, match="has no frame"):
            folder.frame(0, sensor)


def test_localisation_is_measured_on_such_a_drive_and_a_point_cloud_is_not_annotated(tmp_path: Path) -> None:
    read = read_drive("sim:street?seed=4&sensor=vlp16&frames=3")
    assert len(read.cloud(0, np.zeros(6))) > 5000
    bag = bag1(tmp_path / "clouds.bag", [ros1(message(velodyne(60)))[len(ROS1) :]])
    for words in (["annotate", str(bag), "--out", str(tmp_path / "labels")], ["evaluate", "localisation", str(bag)]):
        refused = run_here(*words)
        assert refused.returncode != 0
        assert "takes packets of a spinning sensor, but this source has point clouds" in the_one_line(refused)
