"""A recording, or a bag of its messages, that is coded again or replayed: its poses were gone, and nothing said so."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from lidarcodec import wire
from lidarcodec.api import read_frames
from lidarcodec.apps.publisher.source import FrameFeed
from lidarcodec.commands.pipe import pipe
from lidarcodec.maps.drives import DriveSpec
from lidarcodec.pipeline import StreamEncoder, frames_of
from lidarcodec.recording import RecordingWriter
from lidarcodec.settings import StreamSettings
from lidarcodec.sources import open_source
from tests import packets as made
from tests.command_line import run_here

MOUNT = np.array([[1.0, 0.0, 0.0, 1.5], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 1.75], [0.0, 0.0, 0.0, 1.0]])


def pose(number: float) -> np.ndarray:
    """T_world_sensor of a turn: a metre ahead with each."""
    matrix = np.eye(4)
    matrix[0, 3] = number
    return matrix


@pytest.fixture(scope="module")
def drives(tmp_path_factory):
    """A folder with a recording of turns with poses and a mounting, and a bag of its messages."""
    folder = tmp_path_factory.mktemp("drives")
    encoder = StreamEncoder(StreamSettings(codec="zstd"))
    with (folder / "drive.mcap").open("wb") as file, RecordingWriter(file, "car-7", "roof") as writer:
        for number, frame in enumerate(frames_of(iter(made.turning(1500)), made.sensor())):
            for message in encoder.encode(frame.with_(pose=pose(number), mount=MOUNT)):
                writer.write(wire.pack(message))
    assert run_here("convert", folder / "drive.mcap", folder / "bag", "--as", "messages").returncode == 0
    return folder


@pytest.mark.parametrize("name", ["drive.mcap", "bag"])
def test_coded_again_it_keeps_poses_and_mounting(drives, tmp_path, name):
    done = run_here("encode", drives / name, tmp_path / "again.mcap", "--codec", "pcodec")
    assert done.returncode == 0, done.stderr
    again = list(read_frames(tmp_path / "again.mcap"))
    assert len(again) >= 4
    for number, frame in enumerate(again):
        np.testing.assert_allclose(frame.pose, pose(number), atol=1e-9)
        np.testing.assert_array_equal(frame.mount, MOUNT)


def test_frames_of_another_length_get_the_poses_between(drives):
    stamps = [frame.stamp_ns for frame in read_frames(drives / "drive.mcap")]
    for frame in read_frames(drives / "drive.mcap", "packets:100"):
        if frame.stamp_ns < stamps[-1]:
            expected = np.interp(frame.stamp_ns, stamps, np.arange(len(stamps)))
            np.testing.assert_allclose(frame.pose, pose(expected), atol=1e-6)


def test_a_replay_sends_them(drives):
    feed = FrameFeed(open_source(str(drives / "drive.mcap")), "revolution", 1e6)
    found = []
    feed.mailbox.put = found.append
    feed.run(wait=False)
    assert len(found) >= 4
    for number, frame in enumerate(found):
        np.testing.assert_allclose(frame.pose, pose(number), atol=1e-9)
        assert frame.stamp_ns != feed.source.start_ns or number == 0


def test_a_replay_in_a_loop_loses_none(drives):
    """The last frame of a round is whole only when the next round has begun: its pose was forgotten."""
    feed = FrameFeed(open_source(str(drives / "drive.mcap")), "revolution", 1e6, loop=True)
    found = []

    def put(frame):
        found.append(frame)
        if len(found) == 12:
            feed.close()

    feed.mailbox.put = put
    feed.run(wait=False)
    assert len(found) >= 12
    assert all(frame.pose is not None for frame in found)


@pytest.mark.parametrize("name", ["drive.mcap", "bag"])
def test_a_pipe_passes_them_on(drives, tmp_path, name):
    with (tmp_path / "piped.mcap").open("wb") as out:
        pipe.run(
            str(drives / name), "recording", "pcodec", [], None, None, None, as_json=False, standard=(0, out.fileno())
        )
    for number, frame in enumerate(read_frames(tmp_path / "piped.mcap")):
        np.testing.assert_allclose(frame.pose, pose(number), atol=1e-9)


def test_an_archive_takes_them(drives, tmp_path):
    (tmp_path / "in").mkdir()
    shutil.copy(next((drives / "bag").glob("*.mcap")), tmp_path / "in" / "bag.mcap")
    done = run_here("archive", "run", tmp_path / "in", tmp_path / "archive", "--workers", "here")
    assert done.returncode == 0, done.stderr
    (segment,) = (tmp_path / "archive").rglob("*.mcap")
    for number, frame in enumerate(read_frames(segment)):
        np.testing.assert_allclose(frame.pose, pose(number), atol=1e-9)


@pytest.mark.parametrize("name", ["drive.mcap", "bag"])
def test_a_map_is_built_by_them(drives, name):
    found = DriveSpec(str(drives / name)).given_poses()
    assert found is not None
    np.testing.assert_allclose(found.positions[:, 0], np.arange(len(found)), atol=1e-9)


@pytest.mark.parametrize("name", ["drive.mcap", "bag"])
def test_what_has_no_place_for_them_is_said(drives, tmp_path, name, caplog):
    assert run_here("convert", drives / name, tmp_path / "out.pcap").returncode == 0
    assert "the poses of 5 frames were left out" in caplog.text


def test_verify_says_what_a_recording_lacks(drives, tmp_path):
    """It said that all was identical, though the poses were gone."""
    encoder = StreamEncoder(StreamSettings(codec="pcodec"))
    with (tmp_path / "bare.mcap").open("wb") as file, RecordingWriter(file, "car-7", "roof") as writer:
        for frame in read_frames(drives / "drive.mcap"):
            for message in encoder.encode(frame.with_(pose=None, mount=None)):
                writer.write(wire.pack(message))
    found = run_here("verify", tmp_path / "bare.mcap", drives / "drive.mcap")
    assert found.returncode == 1
    assert "frames lack the pose that they have in the source" in found.stdout
    assert "frames lack the mounting of the sensor that they have in the source" in found.stdout
    assert run_here("verify", tmp_path / "bare.mcap", drives / "drive.mcap", "--allow-part").returncode == 0
    assert run_here("verify", drives / "drive.mcap", drives / "drive.mcap").returncode == 0


def test_a_bag_of_clouds_made_of_it_has_them(drives, tmp_path):
    done = run_here("convert", drives / "bag", tmp_path / "clouds", "--as", "rosbag", "--with-clouds")
    assert done.returncode == 0, done.stderr
    assert "/tf" in done.stdout
