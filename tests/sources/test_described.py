"""A recording of packets has all that its points need: it may be the only file that a vehicle brings home."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from lidarcodec import api
from lidarcodec.errors import CalibrationError
from lidarcodec.recording import RecordingWriter, RotatingRecorder
from lidarcodec.sources import open_source
from lidarcodec.sources.described import ENDING, TEXT, noted, sensor_noted
from tests.command_line import run_here

DRIVES = {
    "ouster": ("sensors/ouster/OS-1-32-G_v2.1.1_1024x10.pcap.xz", "sensors/ouster/OS-1-32-G_v2.1.1_1024x10.json"),
    "hesai": ("sensors/hesai/pandar_40p.pcap.xz", "sensors/calibration/Pandar40P.csv"),
    "velodyne": ("sensors/velodyne/vlp32.pcap.xz", "sensors/calibration/VLP32.yaml"),
    "hdl64e": ("hdl64e_s3_atwall.pcap", "hdl64e_s3_atwall_db.xml"),
}
"""A capture, and the calibration or metadata of its unit."""


def points(path, calibration=None):
    return [frame.cloud() for frame in api.read_frames(path, calibration=calibration)]


def recorded(way, capture, calibration, folder):
    """The recording of the packets of a capture, without anything beside it."""
    if way == "convert":
        done = run_here("convert", capture, folder / "made.mcap", "--as", "packets", "--calibration", calibration)
    else:
        done = run_here("publish", capture, "--record", folder, "--calibration", calibration)
    assert done.returncode == 0, done.stderr
    (recording,) = folder.glob("*.mcap")
    return shutil.move(recording, folder / "elsewhere.mcap")


@pytest.mark.parametrize("way", ["publish", "convert"])
@pytest.mark.parametrize("maker", DRIVES)
def test_points_of_a_recording_of_packets_are_those_of_the_capture(data_file, tmp_path, way, maker):
    capture, calibration = map(data_file, DRIVES[maker])
    recording = recorded(way, capture, calibration, tmp_path)
    ours, theirs = points(recording), points(capture, calibration)
    assert len(ours) == len(theirs)
    assert sum(map(len, ours)) > 1000
    for one, other in zip(ours, theirs, strict=True):
        for axis in "xyz":
            assert np.array_equal(one[axis], other[axis])
    told = run_here("info", recording)
    assert told.returncode == 0, told.stderr
    assert "calibration_file" in told.stdout
    assert len(told.stdout) < 4000, "the text itself is not printed"
    assert "missing" not in told.stderr
    assert "generic" not in told.stderr


def test_a_part_of_such_a_recording_has_it_too(data_file, tmp_path):
    capture, metadata = map(data_file, DRIVES["ouster"])
    recording = recorded("convert", capture, metadata, tmp_path)
    assert run_here("cut", recording, tmp_path / "part.mcap", "--to", "0.05").returncode == 0
    with open_source(tmp_path / "part.mcap") as source:
        assert source.sensor.description == metadata.read_bytes()


def test_what_lies_beside_a_recording_is_preferred(data_file, tmp_path):
    """Somebody who calibrated a sensor anew puts the new file there."""
    capture, calibration = map(data_file, DRIVES["velodyne"])
    recording = recorded("convert", capture, calibration, tmp_path)
    shutil.copy(data_file("sensors/calibration/VLP32MR.yaml"), tmp_path / "elsewhere.yaml")
    with open_source(recording) as source:
        assert source.sensor.origin == "beside"


@pytest.mark.parametrize("text", ["", "{", "<boost_serialization>", "lasers: 3", "x" * 100_000])
@pytest.mark.parametrize("maker", DRIVES)
def test_a_text_that_describes_no_sensor_is_not_used_and_that_is_reported(data_file, tmp_path, caplog, maker, text):
    capture, _ = map(data_file, DRIVES[maker])
    with open_source(capture) as source, (tmp_path / "a.mcap").open("wb") as file:
        packets = [packet for _, packet in zip(range(64), source.packets(), strict=False)]
        with RecordingWriter(file, "a", "b", None, {ENDING: ".json", TEXT: text}) as writer:
            writer.write_packets(packets)
        model = source.sensor.model
    with open_source(tmp_path / "a.mcap") as source:
        assert source.sensor.model in (model, "ouster-32-legacy")
        assert source.sensor.origin in ("generic", "stream")
    assert "is not used" in caplog.text


def test_an_ouster_of_other_packets_is_refused(data_file):
    capture, metadata = map(data_file, DRIVES["ouster"])
    with open_source(capture, calibration=metadata) as source:
        texts, model = noted(source.sensor), source.sensor.model
    with pytest.raises(CalibrationError, match="sends packets"):
        sensor_noted(texts, model, [bytes(100)])
    assert sensor_noted({}, model, []) is None


def test_a_sensor_that_tells_its_metadata_after_its_first_packets_has_them_in_the_next_file(data_file, tmp_path):
    """A vehicle often records before its sensor answers: a quarter of a gigabyte would have no points."""
    capture, metadata = map(data_file, DRIVES["ouster"])
    with open_source(capture, calibration=metadata) as source:
        packets, texts = list(source.packets()), noted(source.sensor)
    recorder = RotatingRecorder(tmp_path, "a", "b")
    for batch in (packets[:20], packets[20:40], packets[40:]):
        assert recorder.write_packets(batch)
        recorder.metadata = texts
    recorder.close()
    first, second = sorted(tmp_path.glob("*.mcap"))
    with open_source(second) as source:
        assert source.sensor.description == metadata.read_bytes()
        assert len(list(source.packets())) == len(packets) - 20
    with open_source(first) as source:
        assert len(list(source.packets())) == 20
