"""Whether a vehicle is well: a check that says so while nothing is published is worse than none."""

from __future__ import annotations

import json
import os
import signal
import socket
import time

import pytest

from lidarcodec.apps import health
from lidarcodec.apps.health import HealthFile, SensorState, complaints
from lidarcodec.apps.vehicle import SensorPlan, Vehicle
from lidarcodec.errors import SettingsError, SourceError
from lidarcodec.settings import StreamSettings
from lidarcodec.transport import Endpoints
from tests.apps.streams import Loop
from tests.command_line import run, run_here, start, the_one_line
from tests.transport.conftest import free_port
from tests.transport.test_contract import eventually


def told(**sensor):
    return {"monotonic_s": 100.0, "boot": health.boot(), "sensors": [{"stream": "car/roof", "quiet_s": 0.0} | sensor]}


@pytest.mark.parametrize(
    ("says", "now_s", "complaint"),
    [
        (told(), 101.0, None),
        (told(), 111.0, "not written its state for 11 s"),
        (told(), 99.0, "not written its state for"),  # left behind by an earlier boot
        (told(quiet_s=10.5), 101.0, "car/roof: no frame came from the sensor for 10 s"),
        (told(unsent_s=11.0), 101.0, "car/roof: nothing was sent for 11 s"),
        (told(failure="no such interface"), 101.0, "car/roof: no such interface"),
        (told(gate=True), 101.0, None),
        (told(gate=False), 101.0, "car/roof: the gate in front of the TLS port does not run"),
    ],
)
def test_what_is_wrong_is_reported_with_the_stream_that_it_is_wrong_with(says, now_s, complaint):
    found = complaints(says, now_s)
    assert (found == []) if complaint is None else (complaint in found[0])


def test_a_file_of_before_the_machine_was_started_is_never_good_news():
    """Once after each start, ten seconds long, its age was right by chance."""
    assert health.boot()
    assert complaints(told() | {"boot": "another"}, 101.0) == [
        "the publisher has not written its state since the machine was started"
    ]


@pytest.mark.parametrize(
    "text", ["", "{", "[]", "{}", '{"monotonic_s": "x", "sensors": []}', '{"monotonic_s": 1}', "[" * 9999]
)
def test_a_file_that_is_none_is_no_good_news(tmp_path, text):
    path = tmp_path / "health.json"
    path.write_text(text)
    with pytest.raises(SourceError):
        complaints(health.read(path), time.monotonic())
    with pytest.raises(SourceError, match=r"publish --health-file"):
        health.read(tmp_path / "none")


def test_frames_that_stop_coming_or_going_grow_old_and_only_those(tmp_path, monkeypatch):
    monkeypatch.setattr(health, "TELL_S", 0.02)
    now = {"assembled": 0, "sent": 0, "matching": False}
    path = tmp_path / "health.json"

    def told_of(name):
        return json.loads(path.read_text())["sensors"][0][name]

    def states():
        if now["assembled"] is not None:
            now["assembled"] += 1
        return [SensorState("car/roof", now["assembled"] or 0, now["sent"], now["matching"])]

    with HealthFile(path, states):
        time.sleep(0.3)
        assert told_of("unsent_s") == 0.0, "nobody receives, so nothing has to be sent"
        now["matching"] = True
        assert eventually(lambda: told_of("unsent_s") > 0.2, 60)
        assert told_of("quiet_s") < 60.0
        now["assembled"] = None
        assert eventually(lambda: told_of("quiet_s") > 0.2, 60)
    assert not path.exists(), "whoever ended is not well"


def test_a_vehicle_tells_of_every_sensor_and_why_one_publishes_nothing(tmp_path):
    def unplugged():
        raise SourceError("no such interface: eth7")

    sensors = [SensorPlan("roof", Loop, StreamSettings()), SensorPlan("front", unplugged, StreamSettings())]
    with Vehicle("car", sensors, Endpoints(loopback_port=free_port())) as vehicle:
        assert eventually(lambda: any(one.assembled > 3 for one in vehicle.states()), 60)
        assert eventually(lambda: vehicle.states()[1].failure is not None, 60)
        found = {one.stream: one.failure for one in vehicle.states()}
    assert found == {"car/roof": None, "car/front": "no such interface: eth7"}


def test_a_publisher_is_well_while_it_publishes_and_not_when_it_stands_still(tmp_path):
    path = tmp_path / "health.json"
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with start("publish", "sim:city", "--listen", endpoint, "--health-file", path) as publishing:
        assert eventually(lambda: path.exists() and run_here("health", "--health-file", path).returncode == 0, 60)
        assert run("health", LIDARCODEC_HEALTH_HEALTH_FILE=str(path)).stdout == "well\n"
        publishing.send_signal(signal.SIGSTOP)
        late = json.loads(path.read_text())["monotonic_s"] + health.STALE_S + 1.0
        assert "not written its state" in complaints(health.read(path), late)[0]
        publishing.send_signal(signal.SIGCONT)
        publishing.send_signal(signal.SIGTERM)
        publishing.communicate(timeout=60)
    assert publishing.returncode == 0
    gone = run_here("health", "--health-file", path)
    assert gone.returncode == 1
    assert "is `lidarcodec publish" in the_one_line(gone)


def test_a_place_that_cannot_be_written_is_reported_before_anything_is_published(tmp_path):
    result = run_here("publish", "sim:city", "--health-file", tmp_path / "no" / "health.json")
    assert result.returncode == 2
    assert "cannot write" in the_one_line(result)
    with pytest.raises(SettingsError), HealthFile(tmp_path / "no" / "health.json", list):
        pass


def test_a_server_that_does_not_answer_or_is_none_is_not_well():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        result = run_here("health", "--url", f"http://127.0.0.1:{taken.getsockname()[1]}")
    assert result.returncode == 1
    assert "does not answer" in the_one_line(result)
    for words in [(), ("--url", "ftp://x"), ("--url", "http://"), ("--url", "http://x", "--health-file", "y")]:
        assert run_here("health", *words).returncode == 2


@pytest.mark.parametrize("kind", ["file", "pipe", "link"])
def test_something_else_of_that_name_stays(tmp_path, kind):
    """A capture that was named by mistake was replaced, and gone at the end."""
    path, other = tmp_path / "drive.pcap", tmp_path / "other"
    other.write_bytes(b"precious")
    if kind == "file":
        path.write_bytes(b"precious")
    elif kind == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to(other)
    with pytest.raises(SettingsError, match="is not a health file"), HealthFile(path, list):
        pass
    assert os.path.lexists(path)
    assert other.read_bytes() == b"precious"
    assert kind != "file" or path.read_bytes() == b"precious"


def test_a_health_file_of_a_publisher_that_was_killed_is_taken_over_and_that_of_another_one_left(tmp_path, caplog):
    path = tmp_path / "health.json"
    gone = {"monotonic_s": 1.0, "pid": 2**30, "sensors": []}
    path.write_text(json.dumps(gone))
    with HealthFile(path, list):
        assert json.loads(path.read_text())["pid"] == os.getpid()
        assert not caplog.records
        other = json.dumps(gone | {"pid": os.getppid()})
    assert not path.exists()
    path.write_text(other)
    with HealthFile(path, list) as file:
        assert "is also written by process" in caplog.text
        file._stop.set()
        file._thread.join(10)
        path.write_text(other)
    assert path.read_text() == other, "it is the other one's by now"
