"""`localise` from end to end: a drive and a live stream in a map of it, and what is said where that cannot be."""

import io
import json
import threading
import time

import numpy as np
import pytest

from lidarcodec.apps.vehicle import SensorPlan, Vehicle
from lidarcodec.commands.certs import command as certs
from lidarcodec.commands.localise import run as command
from lidarcodec.commands.localise.messages import pose_json, read_odometry, tum_line
from lidarcodec.evaluation.rigid import exp_so3
from lidarcodec.interop.poses import quaternion_of
from lidarcodec.maps.file import MapReader
from lidarcodec.maps.localise.tracker import Estimate
from lidarcodec.maps.served.answers import MapAnswers
from lidarcodec.maps.served.shelf import MapShelf
from lidarcodec.settings import StreamSettings
from lidarcodec.sources import open_source
from lidarcodec.sources.poses import read_poses
from lidarcodec.transport import Endpoints, open_transport
from lidarcodec.transport.base import Priority
from lidarcodec.untrusted.json import read_object
from tests.command_line import run_here, the_one_line
from tests.commands.test_json import check
from tests.sweeps import sampled
from tests.transport.conftest import free_port

SOURCE = "sim:street?frames=6&traffic=0"
POSE = np.eye(4)
POSE[:3, :3], POSE[:3, 3] = exp_so3(np.array([0.1, -0.2, 2.0])), (12.5, -3.25, 1.75)


@pytest.fixture(scope="module")
def street(tmp_path_factory):
    out = tmp_path_factory.mktemp("map") / "street.lcmap"
    ran = run_here("map", "build", SOURCE, "-o", out, "--least-seen", 2)
    assert ran.returncode == 0, ran.stderr
    return out


@pytest.fixture(scope="module")
def start():
    with open_source(SOURCE) as source:
        pose = source.poses.at(source.poses.stamps_ns[0])
    yaw = np.degrees(np.arctan2(pose[1, 0], pose[0, 0]))
    return f"{pose[0, 3] + 1:.2f},{pose[1, 3] - 1:.2f},{yaw + 5:.1f}"


def test_a_drive_that_is_found_nowhere_is_an_error_and_leaves_no_file_of_poses(street, tmp_path):
    """It ended with code 0 and "0 of 3 scans found", and left a file without poses."""
    out = tmp_path / "poses.txt"
    ran = run_here("localise", "sim:bend?frames=1", "--map", street, "-o", out)
    assert ran.returncode == 1
    assert "no scan of 1 was found in street" in the_one_line(ran)
    assert not list(tmp_path.iterdir())


@pytest.mark.sweep
def test_a_drive_is_found_in_its_map_and_its_poses_are_written(street, start, tmp_path):
    out = tmp_path / "poses.txt"
    ran = run_here("localise", SOURCE, "--map", street, "--start", start, "-o", out, "--json")
    assert ran.returncode == 0, ran.stderr
    assert "first fix after" in the_one_line(ran)
    found = json.loads(ran.stdout)
    check("localise", found)
    assert (found["scans"], found["tracked"], found["state"], found["first_fix_scans"]) == (6, 4, "tracking", 3)
    poses = read_poses(out)
    assert len(poses) == 4
    with open_source(SOURCE) as source:
        off = [np.linalg.norm(poses.at(int(at))[:3, 3] - source.poses.at(int(at))[:3, 3]) for at in poses.stamps_ns]
    assert max(off) < 0.05


def test_scans_are_looked_for_in_a_map_whole_and_thinned(street):
    ran = run_here("evaluate", "localisation", SOURCE, "--map", street, "--stride", 2, "--json")
    assert ran.returncode == 0, ran.stderr
    found = json.loads(ran.stdout)
    check("evaluate localisation", found)
    assert [(one["scans"], one["of"], one["lost"], one["lost_steps"]) for one in found] == [
        ("whole", 2, 0, []), ("2 %", 2, 0, []),
    ]  # fmt: skip
    assert found[0]["mate_m"] < 0.05
    for words, named in (
        (["--map", street, "--map", "whole"], "--map whole"),
        (["--map", street, "--codec", "zstd"], "--codec"),
        (["--map", "absent.lcmap"], "absent.lcmap"),
    ):
        ran = run_here("evaluate", "localisation", SOURCE, *words)
        assert ran.returncode in (1, 2)
        assert named in the_one_line(ran)


@pytest.mark.parametrize("where", sampled(["file", "network"], ["network"]))
def test_a_live_stream_is_found_and_its_poses_are_on_a_key(where, street, start, capsys):
    """The vehicle says about where it is, so that no search is needed. It also serves the map."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    seen, done = [], threading.Event()
    x, y, yaw = map(float, start.split(","))
    hint = np.eye(4)
    hint[:3, :3], hint[:3, 3] = exp_so3(np.array([0.0, 0.0, np.radians(yaw)])), (x, y, 1.8)

    def drive():
        with open_transport(Endpoints.of(connect=endpoint)) as office:
            office.listen("lidarcodec/v1/car/roof/pose/*", lambda key, data: seen.append((key, read_object(data))))
            odometry = office.sender("lidarcodec/v1/car/roof/odometry", Priority.STATUS)
            plan = SensorPlan(
                "roof",
                lambda: open_source("sim:street?frames=60&traffic=0&speed=0.5", realtime=True, restamp=True),
                StreamSettings(codec="zstd", reduction="columns:8"),
                live=False,
            )
            answering = MapAnswers(MapShelf([street])).declare(office)
            with Vehicle("car", [plan], Endpoints.of(connect=endpoint)) as vehicle:
                while not done.wait(0.05):
                    told = {"stamp_ns": time.time_ns(), "T_world_sensor": hint[:3].ravel().tolist()}
                    odometry.put(json.dumps(told).encode())
                    odometry.put(b"no odometry")
                vehicle.interrupt()
            answering.close()

    driving = threading.Thread(target=drive)
    driving.start()
    town = street if where == "file" else command.town_of("street")
    asked = command.Asked("car/roof", town, None, None, 8, 0, force=False)
    try:
        command.live(asked, "car/roof", "desk", False, ([], [endpoint], None), True)
    finally:
        done.set()
        driving.join()
    found = json.loads(capsys.readouterr().out)
    check("localise", found)
    key, last = seen[-1]
    assert (found["scans"], found["state"], found["lost"]) == (8, "tracking", 0)
    assert found["received"]["frames"] >= 8
    with MapReader.open(street) as reader:
        assert found["tiles_received"] == (None if where == "file" else len(reader.places))
    assert last["map"] == "street"
    assert key == "lidarcodec/v1/car/roof/pose/desk"
    assert {one["state"] for _, one in seen} == {"searching", "tracking"}
    assert len(last["T_world_sensor"]) == 12
    assert len(last["covariance"]) == 36
    assert max(last["sigma_m"]) < 0.1


@pytest.mark.parametrize(
    ("words", "named", "code"),
    [
        (["car/roof", "--map", "absent.lcmap"], "absent.lcmap", 1),
        ([SOURCE, "--map", "absent"], "map fetch absent", 2),
        ([SOURCE, "--map", "STREET", "--start", "1,2"], "X,Y,YAW", 2),
        ([SOURCE, "--map", "STREET", "--start", "9000,2,0"], "no points within", 2),
        ([SOURCE, "--map", "STREET", "-o", "poses.csv"], ".txt", 2),
        ([SOURCE, "--map", "STREET", "--until-end"], "--until-end", 2),
        ([SOURCE, "--map", "STREET", "--connect", "tcp/127.0.0.1:1"], "--connect", 2),
        (["car/roof", "--map", "STREET", "--skip", "3"], "--skip", 2),
        (["sim:street", "--map", "STREET"], "--frames", 2),
        (["drives/a.pcap", "--map", "STREET"], "drives/a.pcap", 1),
        ([SOURCE, "--map", __file__], "not a map", 1),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(street, words, named, code):
    ran = run_here("localise", *[street if word == "STREET" else word for word in words])
    assert ran.returncode == code, ran.stderr
    assert named in the_one_line(ran)


def test_a_viewer_is_told_that_its_poses_reach_nobody(tmp_path, caplog):
    """The rules of a deployment let only operators say where a sensor is, and drop the rest without a word."""
    pytest.importorskip("cryptography")
    folder = tmp_path / "files"
    given = {"vehicles": ["car-7"], "viewers": ["anna"], "operators": ["olga"]}
    certs.run(folder, routers=["a.example"], **given, auth=None, port=None, days=9)
    for name, warned in (("viewer-anna", True), ("operator-olga", False)):
        config = folder / f"{name}.json5"
        caplog.clear()
        ran = run_here("localise", "car-7/roof", "--map", tmp_path / "no.lcmap", "--zenoh-config", config)
        assert (ran.returncode, "anna is a viewer" in caplog.text) == (1, warned), ran.stderr


def test_streams_and_sources_are_told_apart(tmp_path, monkeypatch):
    assert (
        command.key_of("car/roof")
        == command.key_of("zenoh:car/roof")
        == command.key_of("lidarcodec/v1/car/roof")
        == "car/roof"
    )
    assert [
        command.key_of(text) for text in ("sim:city", "udp://0.0.0.0:2368", "drive.pcap", "drives/a.mcap", "a/b/c")
    ] == ([None] * 5)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "car" / "roof").mkdir(parents=True)
    assert command.key_of("car/roof") is None


def test_a_pose_is_told_whole_and_nothing_is_told_for_none():
    lost = read_object(pose_json(Estimate(5, "lost", None, None, 0.25, 0.5), "town", "local"))
    assert (lost["state"], lost["T_world_sensor"], lost["covariance"], lost["sigma_m"]) == ("lost", None, None, None)
    found = Estimate(7, "tracking", POSE, np.diag([1e-4] * 3 + [1e-6] * 3), 0.9, 0.8)
    told = read_object(pose_json(found, "town", "UTM 32N"))
    assert np.abs(np.array(told["T_world_sensor"]).reshape(3, 4) - POSE[:3]).max() < 1e-8
    assert told["sigma_m"] == [0.01] * 3
    assert (told["map"], told["frame"], told["share"]) == ("town", "UTM 32N", 0.9)


def test_odometry_of_any_shape_is_read_and_all_else_is_dropped():
    numbers = POSE[:3].ravel().tolist()
    for shape in (numbers, POSE.ravel().tolist(), POSE[:3].tolist(), POSE.tolist()):
        stamp, pose = read_odometry(json.dumps({"stamp_ns": 5, "T_world_sensor": shape}).encode())
        assert stamp == 5
        assert np.abs(pose - POSE).max() < 1e-9
    far, skewed = [*numbers[:3], 1e300, *numbers[4:]], [2 * value for value in numbers]
    for told in (
        {"stamp_ns": 5}, {"T_world_sensor": numbers}, {"stamp_ns": "5", "T_world_sensor": numbers},
        {"stamp_ns": 1 << 63, "T_world_sensor": numbers}, {"stamp_ns": 5, "T_world_sensor": numbers[:11]},
        {"stamp_ns": 5, "T_world_sensor": ["a"] * 12}, {"stamp_ns": 5, "T_world_sensor": {"a": 1}},
        {"stamp_ns": 5, "T_world_sensor": far}, {"stamp_ns": 5, "T_world_sensor": skewed},
        {"stamp_ns": 5, "T_world_sensor": [None] * 12}, {"stamp_ns": 5, "T_world_sensor": [[1.0], [2.0, 3.0]]}, [], 5,
    ):  # fmt: skip
        assert read_odometry(json.dumps(told).encode()) is None, told
    assert read_odometry(b"\xff{") is None
    assert read_odometry(b"[" * 9000) is None


def test_a_line_of_tums_form_reads_back(tmp_path):
    utm = POSE.copy()
    utm[:2, 3] = 456114.5871, 5427629.2142
    path = tmp_path / "poses.txt"
    path.write_text(
        "# time x y z qx qy qz qw\n" + tum_line(1_767_225_600_258_461_308, POSE) + tum_line(2 * 10**18, utm)
    )
    poses = read_poses(path)
    assert np.abs(poses.at(int(poses.stamps_ns[0])) - POSE).max() < 1e-7
    assert np.abs(poses.at(int(poses.stamps_ns[1])) - utm).max() < 1e-3
    assert quaternion_of(POSE)[3] >= 0


def test_poses_that_are_not_in_the_file_are_told(caplog):
    """One scan with a time an hour ahead, and no pose behind it was in the file, without a word."""
    poses = command._Poses(None, io.StringIO())
    for second in (1, 2, 3600, 3, 4, 5):
        poses.write(Estimate(second * 10**9, "tracking", POSE, np.eye(6), 1.0, 1.0))
    assert poses._file.getvalue().count("\n") == 3
    poses.say()
    assert "3 poses are not in the file" in caplog.text
