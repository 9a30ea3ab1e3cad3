"""What a user loses if these fail: half a metre of accuracy, without a word, because no calibration was found."""

from __future__ import annotations

import json
import logging
import socket
import time

import pytest

from lidarcodec.apps.publisher.publisher import Publisher
from lidarcodec.sensors import generic_sensor, status_bytes, write_calibration
from lidarcodec.sources import open_source, unit_calibration
from lidarcodec.sources.unit_calibration import is_generic, note_of
from lidarcodec.transport.memory import MemoryNetwork
from lidarcodec_server.told import read_status
from tests.command_line import run_here
from tests.sources import captures as c
from tests.transport.test_contract import eventually

MEANS = "clouds can be wrong by up to about half a metre"


@pytest.fixture(autouse=True)
def _nothing_said(monkeypatch):
    monkeypatch.setattr(unit_calibration, "_said", set())


@pytest.fixture
def capture(tmp_path):
    path = tmp_path / "drive.pcap"
    path.write_bytes(c.pcap(c.frame(c.payload(k)) for k in range(800)))
    return path


def test_a_capture_without_a_calibration_is_reported_once_with_what_it_means(capture, caplog):
    for _ in range(3):
        open_source(capture).close()
    (record,) = caplog.records
    assert record.levelno == logging.WARNING
    assert f"{capture}: this unit has no calibration of its own" in record.message
    assert MEANS in record.message
    assert "give --calibration FILE" in record.message


def test_a_calibration_that_is_given_or_beside_is_not_said(capture, caplog):
    sensor = generic_sensor("HDL-64E S1")
    given = capture.parent / "own.yaml"
    write_calibration(sensor, given)
    open_source(capture, calibration=given).close()
    write_calibration(generic_sensor("HDL-64E S2.1"), capture.with_name("drive_db.xml"))
    open_source("sim:city?frames=1").close()
    assert not caplog.records


def test_the_simulator_is_not_taken_for_a_generic_sensor():
    with open_source("sim:city?frames=1") as source:
        assert not is_generic(source.sensor)


def test_commands_that_make_points_say_it_once_and_others_do_not(capture, caplog):
    """Three lines at every command buried the one new warning among them, where packets are only kept."""
    recording, folder = capture.with_name("a.mcap"), capture.parent
    for words, times in (
        (("encode", capture, recording), 0),
        (("encode", capture, folder / "points.mcap", "--with-clouds"), 1),
        (("encode", recording, folder / "added.mcap", "--with-clouds"), 1),
        (("decode", recording, folder / "clouds"), 1),
        (("decode", recording, folder / "back.pcap"), 0),
        (("verify", recording, capture), 0),
        (("bench", capture, "--codec", "raw"), 1),
        (("convert", capture, folder / "b.mcap"), 0),
        (("convert", capture, folder / "bag"), 0),
        (("convert", capture, folder / "b.ply"), 1),
    ):
        caplog.clear()
        unit_calibration._said.clear()
        done = run_here(*words)
        assert done.returncode == 0, done.stderr
        assert caplog.text.count(MEANS) == times, (words, caplog.text)


def test_info_notes_it_with_what_to_do(capture):
    done = run_here("info", capture)
    assert f"{MEANS}; packets and ranges are not affected; give --calibration FILE" in done.stdout
    assert not done.stderr


def test_a_live_source_says_it_and_says_again_when_the_table_comes(caplog):
    rows = status_bytes(generic_sensor("HDL-64E S2.1"))
    payloads = [c.payload(k)[:1204] + rows[k % len(rows)].tobytes() for k in range(len(rows) + 16)]
    with (
        open_source("udp://127.0.0.1:0?wait=0.01&idle=0.2") as source,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock,
    ):
        for number, payload in enumerate(payloads):
            sock.sendto(payload, source.address)
            if number % 50 == 0:
                time.sleep(0.002)
        came: list = []
        assert eventually(lambda: came.extend(source.packets()) or len(came) >= len(payloads), 60)
        assert len(came) == len(payloads)
        assert source.sensor.origin == "stream"
        assert MEANS in caplog.text
        assert "wait for the sensor's own table" in caplog.text
        assert f"the calibration {source.sensor.hash} from the sensor's status bytes is used" in caplog.text


def test_whoever_looks_at_a_stream_is_told_of_a_generic_calibration(capture):
    with open_source(capture) as source, Publisher(source, transport=MemoryNetwork().transport()) as publisher:
        assert publisher.status()["sensor_model"]["note"] == f"generic calibration: {unit_calibration.MEANING}"
        told = read_status(json.dumps(publisher.status()).encode())
        assert told.status["sensor_model"]["note"].startswith(
            "generic calibration: clouds can be wrong"
        )  # to REST, too
    with open_source("sim:city?frames=1") as source:
        assert note_of(source.sensor) is None
