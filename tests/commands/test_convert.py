"""What a user loses if these fail: packets on the way from one program's files to another's, or a file he had."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest

from lidarcodec.interop import ros
from lidarcodec.packet import Packet
from lidarcodec.pipeline import frames_of
from lidarcodec.sensors import write_db_xml
from lidarcodec.sources import open_source
from lidarcodec.sources.captures.pcap_writer import PcapWriter
from tests import packets as made
from tests.command_line import run_here
from tests.packets import packets_in

PACKETS = made.turning(700)


@pytest.fixture
def capture(tmp_path) -> Path:
    """A capture of two frames and four packets, with a calibration beside it."""
    with (tmp_path / "drive.pcap").open("wb") as file:
        PcapWriter(file).write_all(PACKETS)
    write_db_xml(made.sensor(), tmp_path / "drive_db.xml")
    return tmp_path / "drive.pcap"


def convert(*words: object) -> subprocess.CompletedProcess[str]:
    return run_here("convert", *words)


def done(*words: object) -> bool:
    """Convert; whether all went well."""
    return convert(*words).returncode == 0


@pytest.mark.parametrize("codec", ["zstd", "pcodec"])
def test_packets_survive_a_round_through_every_form(tmp_path, capture, codec):
    last = capture
    for number, words in enumerate(
        [["bag"], ["bag.mcap", "--as", "rosbag"], ["coded.mcap", "--codec", codec], ["bare.mcap", "--as", "packets"],
         ["back.pcap"]]
    ):  # fmt: skip
        out = tmp_path / f"{number}_{words[0]}"
        assert done(last, out, *words[1:])
        assert packets_in(out) == PACKETS, words
        last = out
    assert last.read_bytes() == capture.read_bytes()
    with open_source(capture) as first, open_source(last) as again:
        assert np.array_equal(first.sensor.calibration.table, again.sensor.calibration.table), "it travels along"


def test_a_bag_is_read_by_a_public_package_packets_and_points(tmp_path, capture):
    rosbag2 = pytest.importorskip("rosbags.rosbag2", reason="read back by rosbags (extra `bridges`)")
    from tests.interop.test_ros import STORE, points_in

    words = ["--with-clouds", "--topic", "/roof/velodyne_packets", "--frame-id", "roof"]
    assert done(capture, tmp_path / "bag", *words)
    packets: list[Packet] = []
    clouds = []
    with rosbag2.Reader(tmp_path / "bag") as reader:
        assert {one.topic: one.msgtype for one in reader.connections} == {
            "/roof/velodyne_packets": ros.VELODYNE_SCAN.name,
            "/roof/velodyne_points": ros.POINT_CLOUD2.name,
        }
        assert reader.message_count == 6
        for connection, _, data in reader.messages():
            message = STORE.deserialize_cdr(data, connection.msgtype)
            assert message.header.frame_id == "roof"
            if connection.msgtype == ros.POINT_CLOUD2.name:
                clouds.append(points_in(message))
                continue
            packets += [Packet(p.data.tobytes(), p.stamp.sec * 10**9 + p.stamp.nanosec) for p in message.packets]
    assert packets == PACKETS
    with open_source(capture) as source:
        frames = list(frames_of(source.packets(), source.sensor))
    for points, frame in zip(clouds, frames, strict=True):
        assert all(np.array_equal(points[name], frame.cloud()[name]) for name in ("x", "y", "z", "intensity"))


def test_poses_go_along_as_transforms(tmp_path):
    rosbag2 = pytest.importorskip("rosbags.rosbag2", reason="read back by rosbags (extra `bridges`)")
    from tests.interop.test_ros import STORE

    assert done("sim:city?frames=2", tmp_path / "bag", "--with-clouds")
    with open_source("sim:city?frames=2") as source:
        poses = [source.poses.at(frame.stamp_ns) for frame in frames_of(source.packets(), source.sensor)]
    with rosbag2.Reader(tmp_path / "bag") as reader:
        found = [
            STORE.deserialize_cdr(data, connection.msgtype).transforms[0]
            for connection, _, data in reader.messages()
            if connection.topic == "/tf"
        ]
    assert [one.child_frame_id for one in found] == ["velodyne"] * 2
    for one, pose in zip(found, poses, strict=True):
        moved = one.transform.translation
        assert [moved.x, moved.y, moved.z] == pose[:3, 3].tolist()


def test_settings_of_a_recording_are_those_asked_for(tmp_path, capture):
    out = tmp_path / "coarse.mcap"
    words = ["--codec", "pcodec", "--set", "max_error_m=0.1", "--set", "framing=packets:50"]
    assert done(capture, out, *words)
    with open_source(capture) as source, open_source(out) as coarse:
        before = list(frames_of(source.packets(), source.sensor, "packets:50"))
        after = list(coarse.frames())  # type: ignore[attr-defined]
    assert len(before) == len(after) == 14
    errors = [np.abs(a.range.astype(int) - b.range.astype(int)).max() for a, b in zip(before, after, strict=True)]
    assert 0 < max(errors) <= 50


@pytest.mark.parametrize("kind", ["kitti_0005_f000.bin.xz", "kitti_odometry_00_000000.bin.xz"])
def test_kitti_scans_become_bags_and_come_back(tmp_path, data_file, kind, monkeypatch):
    scan = data_file(kind)
    monkeypatch.setenv("LIDARCODEC_DATA", str(scan.parent))
    assert done(scan, tmp_path / "bag")
    assert done(tmp_path / "bag", tmp_path / "back.pcap")
    wanted = packets_in(scan)
    assert packets_in(tmp_path / "back.pcap") == wanted
    with open_source(tmp_path / "bag") as again:
        assert again.sensor.origin == "beside"


def test_the_real_s3_capture_goes_round(tmp_path, data_file):
    capture = data_file("hdl64e_s3_atwall.pcap")
    assert done(capture, tmp_path / "bag", "--frames", 1)
    assert done(tmp_path / "bag", tmp_path / "coded.mcap")
    assert done(tmp_path / "coded.mcap", tmp_path / "back.pcap")
    assert packets_in(tmp_path / "back.pcap") == packets_in(capture)[:43]  # it begins within a turn


def test_what_has_that_name_stays_unless_forced(tmp_path, capture):
    for out in (tmp_path / "out.pcap", tmp_path / "out.mcap"):
        out.write_bytes(b"mine")
        refused = convert(capture, out)
        assert (refused.returncode, "--force" in refused.stderr) == (2, True)
        assert out.read_bytes() == b"mine"
        assert done(capture, out, "--force")
        assert packets_in(out) == PACKETS
    assert done(capture, tmp_path / "bag", "--frames", 1)
    assert convert(capture, tmp_path / "bag").returncode == 2
    assert done(capture, tmp_path / "bag", "--force")
    assert packets_in(tmp_path / "bag") == PACKETS
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "metadata.yaml").write_text("mine")
    (tmp_path / "photos" / "me.jpg").write_text("mine")
    assert convert(capture, tmp_path / "photos", "--force").returncode == 2
    assert (tmp_path / "photos" / "me.jpg").read_text() == "mine"
    assert convert(capture, capture, "--force").returncode == 2, "what is read is never written over"
    assert packets_in(capture) == PACKETS


def test_another_calibration_in_the_way_is_not_replaced(tmp_path, capture):
    (tmp_path / "out_db.xml").write_text("mine")
    refused = convert(capture, tmp_path / "out.pcap")
    assert (refused.returncode, "another calibration" in refused.stderr) == (2, True)
    assert not (tmp_path / "out.pcap").exists()
    assert done(capture, tmp_path / "out.pcap", "--force")
    with open_source(tmp_path / "out.pcap") as source:
        assert source.sensor.origin == "beside"


def test_a_generic_calibration_stays_known_as_such(tmp_path, capture):
    (tmp_path / "drive_db.xml").unlink()
    assert done(capture, tmp_path / "coded.mcap", "--codec", "zstd")
    for out in ("back.pcap", "bag"):
        assert done(tmp_path / "coded.mcap", tmp_path / out)
        with open_source(tmp_path / out) as source:
            assert source.sensor.origin == "generic", "beside the output it would look like one of this unit"


def test_nothing_is_left_of_what_failed(tmp_path, capture):
    before = set(tmp_path.iterdir())
    broken = tmp_path.parent / f"{tmp_path.name}-broken.mcap"
    assert done(capture, broken, "--as", "rosbag")
    scan = bytearray(broken.read_bytes())
    broken.write_bytes(bytes(scan[:200]))
    for out in ("out.pcap", "out.mcap", "bag"):
        assert convert(broken, tmp_path / out).returncode == 1
    late = [Packet(bytes(PACKETS[0].payload), 2**33 * 10**9)] * 400  # a time that neither form can hold
    with (tmp_path.parent / f"{tmp_path.name}-late.mcap").open("wb") as file:
        from lidarcodec.recording import RecordingWriter

        with RecordingWriter(file, "a", "b") as writer:
            writer.write_packets(PACKETS[:400])
            writer.write_packets(late)
    for out in ("out.pcap", "bag"):
        assert convert(file.name, tmp_path / out).returncode == 1
    assert set(tmp_path.iterdir()) == before


def test_a_cut_capture_gives_what_is_whole_and_says_so(tmp_path, capture, caplog):
    cut = tmp_path / "cut.pcap"
    cut.write_bytes(capture.read_bytes()[:-50_000])
    assert done(cut, tmp_path / "bag")
    found = packets_in(tmp_path / "bag")
    assert found == PACKETS[: len(found)]
    assert 600 < len(found) < 700
    assert "truncated" in caplog.text


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["out.txt"], "give a name that ends in .pcap .mcap .npz .ply"),
        (["out.ply", "--codec", "zstd"], "--codec is not for ply"),
        (["out.pcap", "--region", "0,0,1,1"], "--region is only for points"),
        (["out.npz", "--merge"], "--merge is only for files of points"),
        (["out.ply", "--region", "1,0,0,1"], "is an empty box"),
        (["out.ply", "--transform", "1,2,3"], "X,Y,Z,ROLL,PITCH,YAW"),
        (["out.ply", "--from", "noon"], "is not a time"),
        (["out.ply", "--from", "3", "--to", "2"], "is not after"),
        (["scans", "--as", "ply", "--merge"], "into one file"),
        (["out.pcd", "--as", "ply"], "give a name that ends in .ply"),
        (["out.pcap", "--as", "rosbag"], "--as rosbag does not fit"),
        (["out.mcap", "--as", "bag"], "choose one of pcap, recording, packets, rosbag"),
        (["out.pcap", "--codec", "zstd"], "original packets"),
        (["out.pcap", "--with-clouds"], "holds only packets"),
        (["out.mcap", "--topic", "/a"], "are for rosbags"),
        (["bag", "--topic", "a b"], "is not a ROS name"),
        (["out.mcap", "--set", "max_error_m=-1"], "max_error_m"),
    ],
)
def test_what_cannot_be_is_reported_before_anything_is_read(tmp_path, capture, words, said):
    before = set(tmp_path.iterdir())
    refused = convert(capture, tmp_path / words[0], *words[1:])
    assert refused.returncode == 2
    assert said in refused.stderr
    assert set(tmp_path.iterdir()) == before


def test_a_source_without_an_end_needs_a_number(tmp_path):
    refused = convert("sim:city", tmp_path / "out.pcap")
    assert (refused.returncode, "--frames N" in refused.stderr) == (2, True)
    assert convert(tmp_path / "nothing.pcap", tmp_path / "out.pcap").returncode == 1
