"""Mountings from the command line to recordings, bags, merged clouds, maps and the status."""

from __future__ import annotations

import json

import numpy as np
import pytest

import lidarcodec
from lidarcodec.apps.publisher.publisher import Publisher
from lidarcodec.commands.map.build import Asked
from lidarcodec.commands.publish import config as publish_config
from lidarcodec.commands.selection.points import Placing
from lidarcodec.errors import SettingsError
from lidarcodec.interop import ros
from lidarcodec.maps.drives import posed
from lidarcodec.mounting import Mounting
from lidarcodec.sources import open_source
from lidarcodec.sources.mounts import MOST_SENSORS, Mounted, mount_of, read_mounts
from lidarcodec.transport.memory import MemoryNetwork
from tests.apps.streams import Loop
from tests.command_line import run_here, the_one_line
from tests.transport.test_contract import eventually

ROOF = Mounting(1.5, 0.0, 1.8, 0.0, 0.0, 90.0)
TEXT = "1.5,0,1.8,0,0,90"
FILE = "roof: [1.5, 0, 1.8, 0, 0, 90]\nfront: {x_m: 3.2, z_m: 0.6, pitch_deg: 5}\nlidar: '0,0,2,0,0,0'\n"


@pytest.fixture
def mounts(tmp_path):
    path = tmp_path / "mounts.yaml"
    path.write_text(FILE)
    return path


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """Two turns of a sensor that is mounted, with the poses of a vehicle that drives 20 m/s along its x axis."""
    folder = tmp_path_factory.mktemp("mounted")
    (folder / "poses.txt").write_text("".join(f"{1_767_225_600 + i} {20.0 * i} 0 0 0 0 0 1\n" for i in range(3)))
    words = ("--mount", TEXT, "--poses", folder / "poses.txt", "--poses-of", "vehicle", "--with-clouds")
    result = run_here("encode", "sim:street?frames=2", folder / "drive.mcap", *words)
    assert result.returncode == 0, result.stderr
    return folder / "drive.mcap"


def test_a_file_names_all_sensors_of_a_vehicle(mounts, tmp_path):
    found = read_mounts(mounts)
    assert found == {"roof": ROOF, "front": Mounting(3.2, 0, 0.6, 0, 5, 0), "lidar": Mounting(0, 0, 2)}
    assert mount_of(f"{mounts}#front") == mount_of(str(mounts), "front") == found["front"]
    (tmp_path / "one.json").write_text(json.dumps({"roof": ROOF.values()}))
    assert mount_of(str(tmp_path / "one.json")) == mount_of(TEXT) == ROOF
    with pytest.raises(SettingsError, match="choose one, as in"):
        mount_of(str(mounts))
    with pytest.raises(SettingsError, match="no sensor 'rear': choose one of roof, front, lidar"):
        mount_of(str(mounts), "rear")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "1 to 64 lines like"),
        ("[1, 2]", "1 to 64 lines like"),
        ("a/b: [0, 0, 0, 0, 0, 0]", "'a/b' is not a sensor's name"),
        ("roof: [0, 0, 0]", "roof: a mounting is X,Y,Z"),
        ("roof: [0, 0, 200, 0, 0, 0]", "z_m of a mounting is 200; it must be from -100 to 100"),
        ("roof: {z: 1}", "some of x_m, y_m"),
        ("roof: &a [0, 0, 0, 0, 0, 0]", "anchors"),
        ("\n".join(f"s{i}: [0, 0, 0, 0, 0, 0]" for i in range(MOST_SENSORS + 1)), "1 to 64 lines like"),
    ],
)
def test_a_file_that_is_wrong_is_refused_with_the_sensor(tmp_path, text, said):
    (tmp_path / "mounts.yaml").write_text(text)
    with pytest.raises(SettingsError, match=said):
        read_mounts(tmp_path / "mounts.yaml")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--mount", "1,2,3"), "cannot read mountings from 1,2,3"),
        (("--mount", "1,2,3,4,5,x"), "a mounting is X,Y,Z,ROLL,PITCH,YAW"),
        (("--mount", TEXT, "--poses-of", "vehicle"), "give --poses FILE"),
        (("--poses", "p.txt", "--poses-of", "vehicle"), "give --mount"),
        (("--poses-of", "car"), "write sensor or vehicle"),
    ],
)
def test_what_cannot_be_is_reported_in_a_line(tmp_path, words, said):
    for name in ("encode", "convert"):
        result = run_here(name, "sim:street?frames=1", tmp_path / "a.mcap", *words)
        assert result.returncode == 2
        assert said in the_one_line(result)
        assert not (tmp_path / "a.mcap").exists()


def test_a_recording_keeps_it_and_the_pose_is_that_of_the_sensor(recording):
    with open_source(recording) as source:
        assert source.mount == ROOF
        frames = list(source.frames())  # type: ignore[attr-defined]
    for frame in frames:
        np.testing.assert_array_equal(frame.mount, ROOF.T_vehicle_sensor)
        driven_m = 20.0 * (frame.stamp_ns - 1_767_225_600 * 10**9) * 1e-9
        np.testing.assert_allclose(frame.pose, Mounting(driven_m).T_vehicle_sensor @ ROOF.T_vehicle_sensor, atol=1e-6)


def test_merged_points_lie_as_the_vehicle_sees_them_at_the_first_frame(recording):
    with open_source(recording) as source:
        first, second = source.frames()  # type: ignore[attr-defined]
    placing = Placing.of(None, None, merge=True)
    merged = [placing.points(frame) for frame in (first, second)]
    driven_m = 20.0 * (second.stamp_ns - first.stamp_ns) * 1e-9
    for cloud, frame, ahead_m in zip(merged, (first, second), (0.0, driven_m), strict=True):
        plain = frame.cloud()
        np.testing.assert_allclose(cloud["x"], 1.5 - plain["y"] + ahead_m, atol=1e-3)
        np.testing.assert_allclose(cloud["y"], plain["x"], atol=1e-3)
        np.testing.assert_allclose(cloud["z"], plain["z"] + 1.8, atol=1e-3)


def test_a_bag_has_it_as_tf_static_that_late_listeners_get(recording, tmp_path):
    rosbag2 = pytest.importorskip("rosbags.rosbag2", reason="read back by rosbags (extra `bridges`)")
    from tests.interop.test_ros import STORE

    poses = ("--poses", recording.with_name("poses.txt"))
    words = ("--with-clouds", "--mount", TEXT, *poses, "--poses-of", "vehicle")
    assert run_here("convert", "sim:street?frames=2", tmp_path / "bag", *words).returncode == 0
    found: dict[str, list] = {}
    with rosbag2.Reader(tmp_path / "bag") as reader:
        (static,) = [one for one in reader.connections if one.topic == "/tf_static"]
        assert static.msgtype == ros.TF_MESSAGE.name
        (quality,) = static.ext.offered_qos_profiles
        assert (quality.durability.name, quality.reliability.name) == ("TRANSIENT_LOCAL", "RELIABLE")
        for connection, _, data in reader.messages():
            if "/tf" in connection.topic:
                message = STORE.deserialize_cdr(data, connection.msgtype)
                found.setdefault(connection.topic, []).extend(message.transforms)
    (mount,) = found["/tf_static"]
    assert (mount.header.frame_id, mount.child_frame_id) == ("base_link", "velodyne")
    moved, turned = mount.transform.translation, mount.transform.rotation
    assert [moved.x, moved.y, moved.z] == [1.5, 0.0, 1.8]
    np.testing.assert_allclose([turned.x, turned.y, turned.z, turned.w], [0, 0, 0.5**0.5, 0.5**0.5], atol=1e-12)
    assert [(one.header.frame_id, one.child_frame_id) for one in found["/tf"]] == [("map", "base_link")] * 2
    assert all(abs(one.transform.translation.z) < 1e-6 for one in found["/tf"]), "the vehicle's, not the sensor's"


def test_viewers_of_a_recording_get_it_with_each_cloud(recording):
    reader = pytest.importorskip("mcap.reader")
    schemas = pytest.importorskip("foxglove_schemas_protobuf.FrameTransform_pb2")
    with recording.open("rb") as file:
        found = [
            (channel.topic.rpartition("/")[2], schemas.FrameTransform.FromString(message.data))
            for schema, channel, message in reader.make_reader(file).iter_messages()
            if schema is not None and schema.name == "foxglove.FrameTransform"
        ]
    frames = {(name, one.parent_frame_id, one.child_frame_id) for name, one in found}
    assert frames == {("pose", "world", "vehicle"), ("mount", "vehicle", "vehicle/lidar")}
    assert len(found) == 4


def test_packets_of_a_recording_keep_it_as_text(tmp_path):
    words = ("sim:street?frames=1", tmp_path / "p.mcap", "--as", "packets", "--mount", TEXT)
    assert run_here("convert", *words).returncode == 0
    with open_source(tmp_path / "p.mcap") as source:
        assert (source.mount, source.channel) == (ROOF, "packets")  # type: ignore[attr-defined]
    assert run_here("encode", tmp_path / "p.mcap", tmp_path / "m.mcap").returncode == 0
    with open_source(tmp_path / "m.mcap") as source:
        assert source.mount == ROOF


@pytest.mark.sweep
def test_a_map_of_one_drive_begins_at_the_vehicle(tmp_path):
    spec = "sim:street?frames=2&traffic=0"
    plain, mounted = (
        Asked([spec], tmp_path / "a.lcmap", [], None, 0.02, 1, 1, None, 0, None, mounts).drives()
        for mounts in ([], [TEXT])
    )
    for drives in (plain, mounted):  # as if the simulator's poses were not known
        object.__setattr__(drives[0], "given_poses", lambda: None)
    before, after = (next(posed(drives[0]).scans()) for drives in (plain, mounted))
    T = ROOF.T_vehicle_sensor
    np.testing.assert_allclose(after.pose, T @ before.pose, atol=1e-9)
    np.testing.assert_allclose(after.points, before.points @ T[:3, :3].T + T[:3, 3], atol=1e-6)
    with pytest.raises(SettingsError, match="give --mount once, or once for each"):
        Asked([spec], tmp_path / "a.lcmap", [], None, 0.02, 1, 1, None, 0, None, [TEXT, TEXT]).drives()


def test_a_vehicle_file_gives_each_sensor_its_own(mounts):
    text = (
        f"vehicle: car\nmounts: {mounts}\nsensors:\n"
        "  - {name: roof, source: 'sim:street'}\n"
        "  - {name: front, source: 'sim:street', mount: [1, 2, 3, 0, 0, 0]}\n"
        "  - {name: rear, source: 'sim:street'}\n"
    )
    config = publish_config.parse(text, "car.yaml")
    found = read_mounts(config.mounts)
    assert [sensor.plan(found).mount for sensor in config.sensors] == [ROOF, Mounting(1, 2, 3), None]
    with pytest.raises(SettingsError, match=r"sensors\.0\.mount: a mounting is"):
        publish_config.parse("sensors: [{name: a, source: 'sim:street', mount: [1]}]", "car.yaml")
    with pytest.raises(SettingsError, match="`poses_of: vehicle` needs"):
        publish_config.parse("sensors: [{name: a, source: 'sim:street', poses_of: vehicle}]", "c").sensors[0].plan({})


def test_a_live_stream_says_it_in_frames_and_in_its_status():
    network = MemoryNetwork()
    with (
        Publisher(Loop(), vehicle="car", sensor="roof", rate=20.0, transport=network.transport(), mount=ROOF) as car,
        lidarcodec.subscribe("car/roof", transport=network.transport()) as stream,
    ):
        frame = stream.next(60.0)
        assert frame is not None
        np.testing.assert_array_equal(frame.mount, ROOF.T_vehicle_sensor)
        assert car.status()["mount"] == ROOF.values()
        assert eventually(lambda: (stream.status or {}).get("mount") == ROOF.values())


def test_a_source_that_knows_its_mounting_needs_no_option(recording):
    with open_source(recording) as source:
        Mounted().given_to(source)
        assert Publisher(source, transport=MemoryNetwork().transport()).status()["mount"] == ROOF.values()
