"""`convert` and `decode` into points: from every kind of source, chosen by time, moved, cut and merged."""

import json
import struct

import laspy
import mcap.reader
import numpy as np
import pypcd4
import pytest
import yaml

import lidarcodec
from lidarcodec.commands.outputs.base import NARROW
from lidarcodec.errors import UnknownNameError
from lidarcodec.sensors.clouds.message import read_message
from tests.command_line import run_here, the_one_line
from tests.drives import simulated

SWEEP = pytest.mark.sweep
START_S = 1_767_225_600
"""Of simulated drives, in Unix time."""


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """A capture of three turns beside its recording, its bag, and its poses, at 20 m/s."""
    folder = tmp_path_factory.mktemp("drive")
    capture, recording = folder / "drive.pcap", folder / "drive.mcap"
    simulated("sim:street", capture, "--frames", 3)
    assert run_here("encode", capture, recording).returncode == 0
    assert run_here("convert", capture, folder / "bag").returncode == 0
    lines = (f"{START_S + 0.1 * i:.1f} {2.0 * i} 0 0 0 0 0 1\n" for i in range(5))
    (folder / "poses.txt").write_text("".join(lines))
    return folder


def done(*words):
    result = run_here(*words, "--json")
    assert result.returncode == 0, result.stderr
    return json.loads(result.stdout)


def points(path):
    """Rows of a binary PLY of ours."""
    head, _, body = path.read_bytes().partition(b"end_header\n")
    assert b"uchar intensity" in head
    further = [("return_number", "u1")] if b"return_number" in head else []
    return np.frombuffer(body, np.dtype([*NARROW.descr, *further]))


@pytest.mark.parametrize(
    "source",
    ["drive.mcap", *(pytest.param(name, marks=SWEEP) for name in ("drive.pcap", "bag", "sim:street?frames=3"))],
)
def test_points_are_the_same_from_every_kind_of_source(drive, tmp_path, source):
    spec = source if ":" in source else drive / source
    found = done("convert", spec, tmp_path / "a.ply")
    cloud = np.concatenate([frame.cloud() for frame in lidarcodec.read_frames(drive / "drive.pcap")])
    rows = points(tmp_path / "a.ply")
    assert (found["form"], found["points"]) == ("ply", len(cloud))
    for name in ("x", "y", "z", "intensity", "ring"):
        np.testing.assert_array_equal(rows[name], cloud[name])


@pytest.mark.sweep
def test_scans_of_kitti_and_messages_of_points_are_sources_too(drive, tmp_path):
    clouds = done("convert", drive / "drive.mcap", tmp_path / "clouds.mcap", "--as", "clouds")
    with (tmp_path / "clouds.mcap").open("rb") as file:
        summary = mcap.reader.make_reader(file).get_summary()
    assert summary.statistics.message_count == clouds["frames"]
    found = done("convert", tmp_path / "clouds.mcap", tmp_path / "a.laz")
    assert found["points"] == clouds["points"] == len(laspy.read(tmp_path / "a.laz").points)


def test_clouds_of_any_sensor_make_a_bag_in_a_folder_in_its_own_frame(tmp_path):
    """`ros2 bag play FOLDER` is what people type, and a Hesai is not in the frame of a Velodyne."""
    done("convert", "sim:garage?sensor=xt32m&frames=2", tmp_path / "bag", "--as", "clouds")
    about = yaml.safe_load((tmp_path / "bag" / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert about["relative_file_paths"] == ["bag_0.mcap"]
    assert frames_and_topics(tmp_path / "bag" / "bag_0.mcap") == {("/points", "xt32m")}
    assert done("convert", tmp_path / "bag", tmp_path / "a.ply")["frames"] == about["message_count"] == 2
    words = ("--as", "clouds", "--force", "--topic", "/front/points", "--frame-id", "front")
    done("convert", "sim:garage?sensor=vlp16&frames=1", tmp_path / "bag", *words)
    assert frames_and_topics(tmp_path / "bag" / "bag_0.mcap") == {("/front/points", "front")}
    done("convert", "sim:garage?sensor=vlp16&frames=1", tmp_path / "a.mcap", "--as", "clouds")
    assert frames_and_topics(tmp_path / "a.mcap") == {("/points", "velodyne")}


def frames_and_topics(path):
    """Topic and frame_id of the messages of a bag. After head, stamp and length comes the text of the frame."""
    with path.open("rb") as file:
        messages = [(channel.topic, one.data) for _, channel, one in mcap.reader.make_reader(file).iter_messages()]
    return {(topic, data[16 : 16 + struct.unpack_from("<I", data, 12)[0] - 1].decode()) for topic, data in messages}


DUAL = "sim:garage?sensor=vlp16&returns=dual&frames=2"


@pytest.mark.sweep
def test_all_returns_are_written_with_their_number(tmp_path):
    """A user of a dual sensor gets both returns of each beam, in every format that can say which is which."""
    frames = list(lidarcodec.read_frames(DUAL))
    both = np.concatenate([frame.cloud("all") for frame in frames])
    for ending in ("ply", "pcd", "csv", "laz"):
        found = done("convert", DUAL, tmp_path / f"a.{ending}", "--returns", "all")
        assert found["points"] == len(both)
        assert "second_returns_left_out" not in found
    rows = points(tmp_path / "a.ply")
    assert rows["return_number"].tolist() == both["return_number"].tolist()
    assert np.array_equal(rows["x"], both["x"])
    assert (
        pypcd4.PointCloud.from_path(tmp_path / "a.pcd").pc_data["return_number"].tolist()
        == rows["return_number"].tolist()
    )
    assert (tmp_path / "a.csv").read_text().splitlines()[-1].split(",")[-3] == "2"
    las = laspy.read(tmp_path / "a.laz")
    assert np.array_equal(las.return_number, both["return_number"])
    second = int((both["return_number"] == 2).sum())
    assert int((las.number_of_returns == 2).sum()) == 2 * second > 0
    assert lidarcodec.write_frames(frames, tmp_path / "b.ply", returns="all") == len(both)
    assert (tmp_path / "b.ply").read_bytes() == (tmp_path / "a.ply").read_bytes()


def test_clouds_for_viewers_have_all_returns_with_their_number(tmp_path):
    """RViz and Foxglove showed first returns alone, whatever --returns said."""
    frames = list(lidarcodec.read_frames(DUAL))
    both = [frame.cloud("all") for frame in frames]
    for name in ("a.mcap", "bag"):
        found = done("convert", DUAL, tmp_path / name, "--as", "clouds", "--returns", "all")
        assert found["points"] == sum(map(len, both))
        assert "second_returns_left_out" not in found
        path = tmp_path / name if name.endswith("mcap") else tmp_path / name / f"{name}_0.mcap"
        with path.open("rb") as file:
            sent = [read_message(one.data) for _, _, one in mcap.reader.make_reader(file).iter_messages("/points")]
        assert len(sent) == len(both)
        for message, cloud in zip(sent, both, strict=True):
            assert np.array_equal(message.values("return_number"), cloud["return_number"])
            assert np.array_equal(message.values("z"), cloud["z"])
    refused = run_here("convert", DUAL, tmp_path / "b", "--as", "clouds", "--returns", "all", "--region", "0,0,0,1,1,1")
    assert the_one_line(refused).count("--region is only for files of points") == 1


@pytest.mark.parametrize("name", ["scans", "a.e57", "a.npz"])
def test_all_returns_are_refused_where_they_could_not_be_told_apart(tmp_path, name):
    words = ("--as", "kitti") if name == "scans" else ()
    refused = run_here("convert", DUAL, tmp_path / name, *words, "--returns", "all")
    assert refused.returncode == 2
    assert "--returns all" in the_one_line(refused) or "use .ply, .pcd, .las, .laz, .csv" in the_one_line(refused)
    with pytest.raises(UnknownNameError, match="choose one of first, all"):
        next(iter(lidarcodec.read_frames(DUAL))).cloud("last")
    assert "choose one of first, all" in the_one_line(run_here("convert", DUAL, tmp_path / "a.ply", "--returns", "2"))


def test_second_returns_that_are_left_out_are_counted(tmp_path, caplog):
    spec = DUAL
    frames = list(lidarcodec.read_frames(spec))
    second = sum(len(frame.cloud("all")) - len(frame.cloud()) for frame in frames)
    found = done("convert", spec, tmp_path / "a.ply")
    assert found["second_returns_left_out"] == second > 0
    said = run_here("convert", spec, tmp_path / "clouds.mcap", "--as", "clouds").stdout
    assert f"{second:,} second returns left out (--returns all writes them)" in said
    said = run_here("convert", spec, tmp_path / "c.ply").stdout
    assert f"{second:,} second returns left out (--returns all writes them)" in said
    lidarcodec.write_frames(frames, tmp_path / "b.ply")
    assert f"b.ply: {second:,} second returns left out" in caplog.text
    for name in ("a.npz", "a.pcap"):
        assert "second_returns_left_out" not in done("convert", spec, tmp_path / name)


def test_times_beyond_the_end_name_the_span_of_the_source(drive, tmp_path):
    words = ("cut", drive / "drive.mcap", tmp_path / "a.mcap"), ("convert", drive / "drive.pcap", tmp_path / "a.ply")
    for command in words:
        said = the_one_line(run_here(*command, "--from", "2", "--to", "5"))
        assert "no frame from 2 to 5 (it begins at 2026-01-01T00:00:00." in said
        assert "and lasts 0." in said


def test_decode_takes_a_mounting_as_convert_does(drive, tmp_path):
    words = (
        drive / "drive.mcap",
        tmp_path / "a.ply",
        "--merge",
        "--poses",
        drive / "poses.txt",
        "--mount",
        "1,0,2,0,0,90",
    )
    done("decode", *words)
    done("convert", words[0], tmp_path / "b.ply", *words[2:])
    assert (tmp_path / "a.ply").read_bytes() == (tmp_path / "b.ply").read_bytes()
    done("convert", words[0], tmp_path / "c.ply", *words[2:5])
    assert (tmp_path / "a.ply").read_bytes() != (tmp_path / "c.ply").read_bytes()


def test_decode_is_the_short_form(drive, tmp_path):
    for name, words in (("scans", ()), ("each", ("--as", "las"))):
        one, two = tmp_path / "one" / name, tmp_path / "two" / name
        for folder in (one.parent, two.parent):
            folder.mkdir(exist_ok=True)
        first = done("convert", drive / "drive.mcap", one, *(words or ("--as", "kitti")))
        second = done("decode", drive / "drive.mcap", two, *words)
        assert first["files"] == second["files"]
        files = [(one, two)] if one.is_file() else [(path, two / path.name) for path in one.iterdir()]
        assert all(first.read_bytes() == second.read_bytes() for first, second in files)


@pytest.mark.parametrize(
    ("words", "frames"),
    [
        pytest.param(["--frames", "1"], [0], marks=SWEEP),
        pytest.param(["--skip", "1"], [1, 2], marks=SWEEP),
        pytest.param(["--from", "0.1"], [1, 2], marks=SWEEP),
        pytest.param(["--to", "0.15"], [0, 1], marks=SWEEP),
        (["--from", "2026-01-01T00:00:00.1Z", "--to", "2026-01-01T00:00:00.2+00:00"], [1]),
        (["--from", f"{START_S}100000000", "--skip", "1"], [2]),
    ],
)
def test_frames_are_chosen_by_time_and_by_number(drive, tmp_path, words, frames):
    done("convert", drive / "drive.mcap", tmp_path / "a.ply", *words)
    assert sorted(set(points(tmp_path / "a.ply")["frame"].tolist())) == frames


def test_packets_and_recordings_are_chosen_by_time_too(drive, tmp_path):
    packets = done("convert", drive / "drive.pcap", tmp_path / "a.pcap", "--from", "0.1", "--to", "0.2")["packets"]
    assert 340 <= packets <= 350
    assert done("encode", drive / "drive.pcap", tmp_path / "a.mcap", "--to", "0.15")["frames"] == 2


def test_a_time_without_frames_is_an_error_that_says_it(drive, tmp_path):
    result = run_here("decode", drive / "drive.mcap", tmp_path / "a.ply", "--from", "9")
    assert result.returncode == 1
    assert "no frame from 9" in the_one_line(result)
    assert not (tmp_path / "a.ply").exists()


def test_points_are_moved_and_then_cut(drive, tmp_path):
    done("decode", drive / "drive.mcap", tmp_path / "a.ply", "--frames", 1)
    before = points(tmp_path / "a.ply")
    words = ("--frames", 1, "--transform", "1,2,3,0,0,90", "--region", "-10,-10,0,10,10,5")
    done("decode", drive / "drive.mcap", tmp_path / "b.ply", *words)
    after = points(tmp_path / "b.ply")
    moved = np.stack([1 - before["y"], 2 + before["x"], 3 + before["z"]], axis=-1)
    inside = (np.abs(moved[:, :2]) <= 10).all(axis=1) & (moved[:, 2] >= 0) & (moved[:, 2] <= 5)
    assert 0 < len(after) == inside.sum() < len(before)
    np.testing.assert_allclose(np.stack([after[axis] for axis in "xyz"], axis=-1), moved[inside], atol=1e-4)


def test_merged_frames_lie_where_their_poses_say_as_the_first_one_sees_them(drive, tmp_path):
    refused = run_here("convert", drive / "drive.pcap", tmp_path / "a.ply", "--merge")
    assert refused.returncode == 2
    assert "--poses FILE" in the_one_line(refused)
    done("convert", drive / "drive.pcap", tmp_path / "plain.ply")
    plain = points(tmp_path / "plain.ply")
    stamps_ns = np.array([frame.stamp_ns for frame in lidarcodec.read_frames(drive / "drive.pcap")])
    travelled_m = 20.0 * (stamps_ns - stamps_ns[0]) * 1e-9
    for source in ("drive.pcap", "drive.mcap"):
        done("convert", drive / source, tmp_path / f"{source}.ply", "--merge", "--poses", drive / "poses.txt")
        merged = points(tmp_path / f"{source}.ply")
        np.testing.assert_allclose(merged["x"] - plain["x"], travelled_m[plain["frame"]], atol=0.01)
        np.testing.assert_allclose(merged["y"], plain["y"], atol=1e-3)


def test_frames_that_are_not_placed_are_told_and_how_to_place_them(drive, tmp_path):
    capture, poses = drive / "drive.pcap", drive / "poses.txt"
    for words, told in ((("a.ply",), False), (("d.ply", "--poses", poses), True),
                        (("b.ply", "--frames", "1"), False), (("each", "--as", "ply"), False),
                        (("c.ply", "--merge", "--poses", poses), False)):  # fmt: skip
        result = run_here("convert", capture, tmp_path / words[0], *words[1:])
        assert result.returncode == 0, result.stderr
        assert ("add --merge to place them by poses" in result.stdout) == told, words


def test_a_source_that_knows_its_poses_is_merged_without_a_file(tmp_path):
    found = done("convert", "sim:street?frames=2", tmp_path / "a.pcd", "--merge")
    assert (found["frames"], found["form"]) == (2, "pcd")
