"""What a user loses if these fail: every command on clouds in bags, from info to a bag that is the same again."""

from __future__ import annotations

import json
import warnings

import laspy
import numpy as np
import pytest
from mcap.reader import make_reader

from lidarcodec.commands.outputs.base import WIDE
from lidarcodec.image_frame import cloud_frame
from lidarcodec.planes.clouds.comparison import same_but_near
from lidarcodec.recording import RosbagWriter
from lidarcodec.sensors.clouds.message import read_message
from lidarcodec.sensors.clouds.sensor import cloud_sensor
from lidarcodec.sensors.clouds.values import intensity_of
from tests.command_line import run_here, the_one_line
from tests.packets import payloads_in
from tests.point_clouds import STAMP_NS, message, ouster, ros1, velodyne
from tests.sources.test_cloud_bags import bag1

FRAMES = 3
VELODYNE = [message(velodyne(120, seed=n), stamp_ns=STAMP_NS + n * 10**8) for n in range(FRAMES)]
OUSTER = [message(ouster(128, nan=True), 16, stamp_ns=STAMP_NS + n * 10**8) for n in range(FRAMES)]


@pytest.fixture(params=[VELODYNE, OUSTER], ids=["velodyne", "ouster"])
def messages(request):
    return request.param


@pytest.fixture
def bag(tmp_path, messages):
    path = tmp_path / "clouds.mcap"
    with path.open("wb") as file, RosbagWriter(file, points_topic="/points") as writer:
        for number, one in enumerate(messages):
            writer.write_message(STAMP_NS + number * 10**8, one)
    return path


def ok(*words) -> str:
    done = run_here(*map(str, words))
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_info_says_what_the_messages_are(bag, messages):
    found = json.loads(ok("info", bag, "--json"))
    assert found["model"] == "pointcloud2"
    assert found["frames"] == found["packets"] == FRAMES
    assert "with x y z intensity" in found["evidence"]
    assert found["points"] > 3000


@pytest.mark.parametrize("codec", ["raw", "zstd", "pcodec", "predictive"])
def test_a_recording_decodes_to_a_bag_with_the_very_messages(tmp_path, bag, messages, codec):
    coded, back = tmp_path / "coded.mcap", tmp_path / "back.mcap"
    ok("encode", bag, coded, "--codec", codec)
    ok("decode", coded, back)
    assert payloads_in(back) == payloads_in(coded) == messages
    assert f"{FRAMES}, identical" in ok("verify", coded, bag)


def test_a_bound_holds_and_verify_says_so(tmp_path, bag, messages):
    coded = tmp_path / "coded.mcap"
    ok("encode", bag, coded, "--codec", "predictive", "--set", "max_error_m=0.01")
    report = json.loads(ok("verify", coded, bag, "--json"))
    assert report["lost"] == report["invented"] == 0
    assert report["max_error_m"] <= 0.01
    for mine, theirs in zip(payloads_in(coded), messages, strict=True):
        assert same_but_near(mine, theirs, 0.01)


def test_points_leave_in_other_formats_with_their_fields(tmp_path, bag, messages):
    coded = tmp_path / "coded.mcap"
    ok("encode", bag, coded, "--codec", "zstd")
    for ending in ("npz", "ply"):
        ok("decode", coded, tmp_path / f"out.{ending}")
    (tmp_path / "kitti").mkdir()
    ok("decode", coded, tmp_path / "kitti", "--force")
    found = np.load(tmp_path / "out.npz")
    assert found["000000/message"].tobytes() == messages[0]
    points, sent = found["000001/points"], read_message(messages[1])
    assert np.array_equal(points["x"], sent.values("x")[sent.returns])
    times = "time" if "time" in sent.head.by_name else "t"
    assert np.array_equal(points[times], sent.values(times)[sent.returns])
    assert len(list((tmp_path / "kitti").glob("*.bin"))) == FRAMES


def test_clouds_do_not_go_into_a_capture(tmp_path, bag):
    for words in (("convert", bag, tmp_path / "a.pcap"), ("decode", _encoded(tmp_path, bag), tmp_path / "b.pcap")):
        done = run_here(*map(str, words))
        assert done.returncode
        assert "cannot hold point clouds" in the_one_line(done)


def _encoded(tmp_path, bag):
    ok("encode", bag, tmp_path / "coded.mcap", "--codec", "zstd")
    return tmp_path / "coded.mcap"


def test_packets_are_recorded_as_they_are_and_become_a_bag_again(tmp_path, bag, messages):
    ok("convert", bag, tmp_path / "packets.mcap", "--as", "packets")
    ok("convert", tmp_path / "packets.mcap", tmp_path / "again")
    assert payloads_in(tmp_path / "packets.mcap") == payloads_in(tmp_path / "again") == messages


def test_bench_compares_with_zstd_of_the_messages(bag, messages):
    (found,) = json.loads(ok("bench", bag, "--codec", "predictive", "--json"))
    assert found["packets_identical"]
    assert 3 * found["bits_per_point"]["total"] < found["zstd_bits_per_point"]
    assert found["bits_per_point"]["planes"] > 0.9 * found["bits_per_point"]["total"]


@pytest.mark.parametrize("setting", ["intensity=off", "reduction=voxel"])
def test_fields_and_points_are_not_left_out(bag, setting):
    done = run_here("encode", str(bag), str(bag.with_name("out.mcap")), "--set", setting)
    assert done.returncode
    assert f"leave {setting} out" in the_one_line(done)


def test_a_message_that_is_no_cloud_comes_back_in_a_bag_with_all_others(tmp_path):
    """A topic with one damaged message was encoded, and then gave back nothing."""
    given = [VELODYNE[0], b"\0\1\0\0" + b"nothing" * 9, VELODYNE[1], b""]
    with (tmp_path / "a.mcap").open("wb") as file, RosbagWriter(file, points_topic="/points") as writer:
        for number, one in enumerate(given):
            writer.write_message(STAMP_NS + number * 10**8, one)
    _encoded(tmp_path, tmp_path / "a.mcap")
    ok("decode", tmp_path / "coded.mcap", tmp_path / "back.mcap")
    ok("convert", tmp_path / "a.mcap", tmp_path / "again")
    assert payloads_in(tmp_path / "back.mcap") == payloads_in(tmp_path / "again") == given


def test_a_message_of_ros_1_that_is_cut_is_left_out_of_a_bag_of_ros_2_with_a_warning(tmp_path, caplog):
    plain = [ros1(one)[4:] for one in VELODYNE]
    bag1(tmp_path / "a.bag", [plain[0], plain[1][:-50], plain[2]])
    _encoded(tmp_path, tmp_path / "a.bag")
    for words in (
        ("decode", tmp_path / "coded.mcap", tmp_path / "b.mcap"),
        ("convert", tmp_path / "a.bag", tmp_path / "b"),
    ):
        ok(*words)
        assert "1 messages of ROS 1 that are no whole PointCloud2 were left out" in caplog.text
        caplog.clear()
        assert payloads_in(words[-1]) == [VELODYNE[0], VELODYNE[2]]


def test_intensities_have_one_scale_in_all_messages_of_a_stream(tmp_path):
    """Levels above 255 in one message, and a message of zeros and ones, change nothing in the others."""
    given = []
    for value in (100, 300, 1):
        points = velodyne(60)
        points["intensity"] = value
        given.append(message(points, stamp_ns=STAMP_NS + value * 10**8))
    with (tmp_path / "a.mcap").open("wb") as file, RosbagWriter(file, points_topic="/points") as writer:
        for number, one in enumerate(given):
            writer.write_message(STAMP_NS + number * 10**8, one)
    coded = _encoded(tmp_path, tmp_path / "a.mcap")
    for out in ("a.ply", "kitti", "a.las"):
        ok("decode", coded, tmp_path / out)
    text = (tmp_path / "a.ply").read_bytes()
    points = np.frombuffer(text[text.index(b"end_header\n") + 11 :], WIDE)
    assert [set(points["intensity"][points["frame"] == n]) for n in range(3)] == [{100}, {300}, {1}]
    found = [np.fromfile(tmp_path / "kitti" / f"{n:06d}.bin", "<f4")[3::4] for n in range(3)]
    assert np.allclose([part.mean() * 255 for part in found], [100, 300, 1])
    las = np.asarray(laspy.read(tmp_path / "a.las").intensity)
    assert sorted(set(las.tolist())) == [1, 100, 300]


def test_fractions_count_in_255ths():
    points = velodyne(60)
    points["intensity"] = np.linspace(0, 1, len(points))
    assert intensity_of(read_message(message(points))).max() == 255


@pytest.mark.parametrize(
    "frame_id", ["\U0001f600" * 100, "\x1b[31mred\nlidarcodec: a line of the bag"], ids=["wide", "steering"]
)
def test_names_in_a_message_fit_and_steer_no_terminal(tmp_path, frame_id):
    points = VELODYNE[0]
    at = points.index(b"lidar\0") - 4
    text = frame_id.encode() + b"\0"
    size = len(text).to_bytes(4, "little")
    named = points[:at] + size + text + bytes(-(at + len(text)) % 4) + points[at + 12 :]
    assert read_message(named).head.frame_id == frame_id
    with (tmp_path / "a.mcap").open("wb") as file, RosbagWriter(file, points_topic="/points") as writer:
        writer.write_message(STAMP_NS, named)
    coded = _encoded(tmp_path, tmp_path / "a.mcap")
    for path in (tmp_path / "a.mcap", coded):
        assert not [
            line for line in ok("info", path).splitlines() if not line.isprintable() or "lidarcodec:" in line[:11]
        ]
    ok("decode", coded, tmp_path / "back.mcap")
    assert payloads_in(tmp_path / "back.mcap") == [named]


def test_a_ring_that_is_no_number_gives_no_line_of_code_to_a_user():
    points = velodyne(60).astype([(name, "<f4") for name in velodyne(60).dtype.names])
    points["ring"][3] = np.nan
    payload = message(points)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(cloud_frame(0, STAMP_NS, payload, cloud_sensor([payload])).cloud()) == len(points)


def test_where_the_sensor_was_goes_with_clouds_in_their_own_frame(tmp_path, bag, caplog):
    """A bag with --poses and --mount had neither, and no word said so; nor that --frame-id did nothing."""
    poses = tmp_path / "poses.txt"
    poses.write_text("".join(f"{STAMP_NS / 1e9 + at - 1:.6f} {at} 2 3 0 0 0 1\n" for at in range(4)))
    placed = ("--poses", poses, "--mount", "1,0,2,0,0,0")
    ok("convert", bag, tmp_path / "out.mcap", "--as", "clouds", *placed, "--frame-id", "roof")
    assert "--frame-id is left out" in caplog.text
    with (tmp_path / "out.mcap").open("rb") as file:
        found = [(channel.topic, one.data) for _, channel, one in make_reader(file).iter_messages()]
    static = [data for topic, data in found if topic == "/tf_static"]
    assert [topic for topic, _ in found].count("/tf") == FRAMES
    assert len(static) == 1
    assert b"lidar\0" in static[0]
    assert b"roof" not in b"".join(data for _, data in found)
