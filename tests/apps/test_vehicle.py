"""Several sensors in one process: each is on its own, whatever happens to the others."""

from __future__ import annotations

import shutil
import socket
import subprocess
import sys
import threading
import time

import pytest

import lidarcodec
from lidarcodec.apps import vehicle as module
from lidarcodec.apps.vehicle import SensorPlan, Vehicle
from lidarcodec.commands.publish import config as publish_config
from lidarcodec.errors import SettingsError, SourceError, TransportError
from lidarcodec.settings import StreamSettings
from lidarcodec.sources import open_source
from tests.apps.streams import Loop
from tests.command_line import run, run_here, start, the_one_line
from tests.conftest import ROOT
from tests.transport.conftest import free_port
from tests.transport.test_contract import eventually

ZSTD = StreamSettings(codec="zstd")


def plan(name, source, **more):
    return SensorPlan(name, source, ZSTD, **more)


def frames_of(name, port, count):
    with lidarcodec.subscribe(f"car/{name}", loopback_port=port, timeout_s=20.0) as live:
        return [frame.index for frame, _ in zip(live, range(count), strict=False)]


def test_a_sensor_that_fails_is_tried_again_and_never_stops_the_other(monkeypatch, caplog):
    monkeypatch.setattr(module, "FIRST_WAIT_S", 0.1)
    port, attempts = free_port(), []

    def unplugged():
        attempts.append(time.monotonic())
        if len(attempts) < 3:
            raise SourceError("no such interface: eth7")
        return Loop()

    sensors = [plan("roof", Loop), plan("front", unplugged), plan("file", lambda: open_source("/gone"), live=False)]
    with Vehicle("car", sensors, lidarcodec.Endpoints(loopback_port=port)) as vehicle:
        assert len(frames_of("roof", port, 3)) == 3
        assert len(frames_of("front", port, 3)) == 3
        assert attempts[2] - attempts[1] > attempts[1] - attempts[0]
        assert set(vehicle.failures()) == {"file"}
    assert {status["sensor"] for status in vehicle.statuses()} == {"roof", "front"}
    told = [record.getMessage() for record in caplog.records]
    assert any("car/front: no such interface: eth7; trying again in 0.1 s" in text for text in told)
    assert any("car/file stops publishing" in text for text in told)


def test_a_sensor_that_ends_by_an_error_of_the_program_is_not_well_and_is_tried_again(monkeypatch):
    """Its thread ended: it published nothing more, and the health file said that all sensors are well."""
    monkeypatch.setattr(module, "FIRST_WAIT_S", 0.2)
    port, attempts = free_port(), []

    def no_threads():
        attempts.append(1)
        if len(attempts) < 3:
            raise RuntimeError("can't start new thread")
        return Loop()

    with Vehicle("car", [plan("front", no_threads)], lidarcodec.Endpoints(loopback_port=port)) as vehicle:
        assert eventually(lambda: [one.failure for one in vehicle.states()] != [None], 20)
        assert [one.failure for one in vehicle.states()] == ["unexpected RuntimeError: can't start new thread"]
        assert len(frames_of("front", port, 3)) == 3


class Cut(Loop):
    def packets(self):
        yield from Loop(2).packets()
        raise SourceError("the cable was cut")


def test_a_source_that_breaks_while_it_is_read_is_opened_again(monkeypatch):
    monkeypatch.setattr(module, "FIRST_WAIT_S", 0.1)

    port, opened = free_port(), []
    with Vehicle("car", [plan("roof", lambda: opened.append(1) or Cut())], lidarcodec.Endpoints(loopback_port=port)):
        assert eventually(lambda: len(opened) > 2)


def test_what_a_recording_lacked_before_its_source_was_opened_again_is_not_forgotten(monkeypatch, tmp_path):
    """The exit code told of the last opening only."""
    monkeypatch.setattr(module, "FIRST_WAIT_S", 0.1)
    in_the_way, opened = tmp_path / "kept", []
    in_the_way.write_text("no folder")

    def source():
        opened.append(1)
        if len(opened) == 2:
            in_the_way.unlink()
        return Cut() if len(opened) == 1 else Loop(2)

    where = lidarcodec.Endpoints(loopback_port=free_port())
    with Vehicle("car", [plan("roof", source, record=in_the_way)], where) as vehicle:
        assert eventually(lambda: len(opened) == 2 and list(in_the_way.glob("*.mcap")))
    (status,) = vehicle.statuses()
    assert "File exists" in status["recording"]["stopped"]
    assert status["recording"]["counts"]["files"] == 1


def test_all_sensors_share_one_session_and_stop_soon_when_it_cannot_be_opened():
    taken = socket.socket()
    taken.bind(("127.0.0.1", 0))
    taken.listen()
    endpoint = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
    before = threading.active_count()
    with (
        pytest.raises(TransportError),
        Vehicle("car", [plan("a", Loop), plan("b", Loop)], lidarcodec.Endpoints.of(listen=endpoint)) as vehicle,
    ):
        vehicle.wait()
    taken.close()
    assert eventually(lambda: threading.active_count() <= before)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("sensors: []", "sensors must have at least 1 item"),
        ("vehicle: car 7\nsensors: [{name: a, source: x}]", "vehicle must match"),
        ("sensors: [{name: a}]", "sensors.0.source is missing"),
        ("sensors: [{name: a, source: x, colour: red}]", "sensors.0.colour does not exist"),
        ("sensors: [{name: a, source: x, codec: mp3}]", "sensors.0.settings: unknown codec 'mp3'"),
        ("sensors: [{name: a, source: x, settings: {level: 99}}]", "sensors.0.settings: "),
        ("sensors: [{name: a, source: x, rate: 0}]", "sensors.0.rate"),
        ("sensors: [{name: a, source: x}, {name: a, source: y}]", "two sensors have the name 'a'"),
        ("sensors: [{name: a, source: x, record: {folder: d, gb: -1}}]", "sensors.0.record.gb"),
        ("[1, 2]", "has no fields"),
        ("a: [", "is not YAML"),
        ("[" * 5000, "nested more than 16 deep"),
        ("sensors: !!python/object/apply:os.system ['true']", "anchors or tags"),
    ],
)
def test_a_mistake_in_the_file_is_named_by_its_field(text, said):
    with pytest.raises(SettingsError) as caught:
        publish_config.parse(text, "cars.yaml")
    assert str(caught.value).startswith("cars.yaml")
    assert said in str(caught.value)


def test_the_file_that_is_shipped_is_a_good_one():
    config = publish_config.read(ROOT / "packaging" / "publish.yaml")
    assert [sensor.plan().live for sensor in config.sensors] == [True, True]
    assert [sensor.stream_settings().codec for sensor in config.sensors] == ["pcodec", "jpeg"]


def test_the_command_publishes_every_sensor_of_a_file_and_says_which_failed(tmp_path):
    file, port = tmp_path / "cars.yaml", free_port()
    keep = f"record: {{folder: {tmp_path / 'kept'}}}"
    file.write_text(
        f"vehicle: car\nconnect: [tcp/127.0.0.1:{port}]\nsensors:\n"
        f"  - {{name: roof, source: 'sim:road?frames=8', rate: 20, {keep}}}\n  - {{name: lost, source: gone.pcap}}\n"
    )
    assert "cannot be combined with --config" in the_one_line(run_here("publish", "sim:road", "--config", file))
    publisher = start("publish", "--config", file)  # nobody listens: it records all the same, and waits
    assert eventually(lambda: list(tmp_path.glob("kept/*.mcap")), 60)
    publisher.terminate()
    _, err = publisher.communicate(timeout=60)
    assert publisher.returncode == 0, err
    assert "car/lost stops publishing: gone.pcap does not exist" in err
    file.write_text(
        "vehicle: car\nsensors:\n  - {name: roof, source: 'sim:road?frames=8', rate: max, settings: {x: 1}}"
    )
    assert "sensors.0.settings: " in the_one_line(run_here("publish", "--config", file))
    file.write_text(
        "sensors:\n  - {name: roof, source: 'sim:road?frames=3', rate: 20}\n  - {name: lost, source: gone}\n"
    )
    ended = run("publish", "--config", file, LIDARCODEC_LOOPBACK_PORT=str(port))
    assert ended.returncode == 1
    assert ended.stdout.startswith("vehicle/roof: ")
    assert "vehicle/lost: gone does not exist" in ended.stderr


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="needs systemd-analyze")
@pytest.mark.parametrize("command", ["publish", "serve", "subscribe@"])
def test_systemd_takes_a_unit_that_says_when_it_is_ready(tmp_path, command):
    unit = (ROOT / "packaging" / f"lidarcodec-{command}.service").read_text()
    assert {"Type=notify", "WatchdogSec=30"} <= set(unit.splitlines())
    assert f"/opt/lidarcodec/bin/lidarcodec {command.rstrip('@')} " in unit
    copy = tmp_path / f"lidarcodec-{command}.service"
    copy.write_text(unit.replace("/opt/lidarcodec/bin/lidarcodec", sys.executable))
    done = subprocess.run(["systemd-analyze", "verify", copy], capture_output=True, text=True, check=False, timeout=60)
    about_it = [line for line in done.stderr.splitlines() if copy.name in line]
    assert not about_it, done.stderr
