"""What a user would lose here: the right calibration, picked up without asking, and being told which one it was."""

from __future__ import annotations

import logging
from importlib.resources import files
from pathlib import Path

import pytest

from lidarcodec.errors import CalibrationError, UnknownNameError
from lidarcodec.sensors import find_calibration, generic_sensor, model_of, write_calibration
from tests.packets import read_plain_pcap, turning
from tests.sensors.test_status import stream

PLAIN = [packet.payload for packet in turning(20)]
ONE, OTHER = generic_sensor("HDL-64E S1"), generic_sensor("HDL-64E S2.1")


def test_the_order_is_given_beside_stream_generic(tmp_path: Path) -> None:
    capture = tmp_path / "drive.v2.pcap.xz"
    sent = stream(4200)
    assert find_calibration(capture, None, PLAIN).origin == "generic"
    assert find_calibration(None, None, sent).origin == "stream"
    write_calibration(ONE, tmp_path / "db.xml")
    found = find_calibration(capture, None, sent)
    assert (found.origin, found.calibration["dist_correction_m"][0]) == (
        "beside",
        ONE.calibration["dist_correction_m"][0],
    )
    write_calibration(OTHER, tmp_path / "drive.v2.yaml")
    assert find_calibration(capture, None, sent).calibration["dist_correction_m"][0] == pytest.approx(1.5195264)
    write_calibration(ONE, tmp_path / "drive.v2_db.xml")
    assert find_calibration(capture, None, sent).calibration["dist_correction_m"][0] == pytest.approx(0.1)
    given = find_calibration(capture, tmp_path / "drive.v2.yaml", sent)
    assert (given.origin, given.calibration["dist_correction_m"][0]) == ("given", pytest.approx(1.5195264))


@pytest.mark.parametrize("capture", ["drive.pcap", "drive.pcapng", "drive.pcap.zst", "drive.mcap", "drive"])
def test_a_captures_name_is_what_stands_before_its_endings(tmp_path: Path, capture: str) -> None:
    write_calibration(ONE, tmp_path / "drive_db.xml")
    assert find_calibration(tmp_path / capture, None, []).origin == "beside"
    assert find_calibration(tmp_path / "driver.pcap", None, []).origin == "generic"


def test_a_name_that_leaves_no_room_for_an_ending_is_no_obstacle(tmp_path: Path) -> None:
    assert find_calibration(tmp_path / ("n" * 250 + ".pcap"), None, PLAIN).origin == "generic"


def test_a_folder_may_hold_its_calibration(tmp_path: Path) -> None:
    folder = tmp_path / "2011_09_26.drive"
    folder.mkdir()
    write_calibration(ONE, folder / "db.xml")
    assert find_calibration(folder, None, []).origin == "beside"


def test_a_file_beside_that_is_something_else_is_skipped_with_a_warning(tmp_path: Path, data_file, caplog) -> None:
    (tmp_path / "drive.yaml").write_text("rosbag2: {files: []}")
    (tmp_path / "db.xml").write_bytes(data_file("vlp16_db.xml").read_bytes())
    with caplog.at_level(logging.WARNING):
        assert find_calibration(tmp_path / "drive.pcap", None, PLAIN).origin == "generic"
    assert [record.getMessage().split(": ")[0] for record in caplog.records] == ["not used", "not used"]
    assert "16 lasers are enabled" in caplog.text
    with pytest.raises(CalibrationError, match="16 lasers"):
        find_calibration(tmp_path / "drive.pcap", tmp_path / "db.xml", PLAIN)


def test_the_real_capture_finds_its_calibration_and_kitti_asks_for_one(data_file) -> None:
    assert find_calibration(data_file("hdl64e_s3_atwall.pcap"), None, PLAIN).origin == "beside"
    kitti = data_file("kitti_tracking0006_f000-010.pcap.xz")
    payloads = [packet.payload for packet in read_plain_pcap(kitti)]
    assert (found := find_calibration(kitti, None, payloads)).origin == "generic"
    assert found.name == "HDL-64E S2"


def test_the_model_is_seen_from_blocks_and_warning_types(data_file) -> None:
    assert model_of(PLAIN) == "HDL-64E S2"
    assert model_of([]) == "HDL-64E S2"
    assert model_of(stream(200, 60, s3=True)) == "HDL-64E S3"
    assert model_of([p.payload for p in read_plain_pcap(data_file("hdl64e_s3_atwall.pcap"))]) == "HDL-64E S3"


@pytest.mark.parametrize("model", ["HDL-64E S1", "HDL-64E S2", "HDL-64E S2.1", "HDL-64E S3"])
def test_every_model_has_a_generic_table_with_a_named_source(model: str) -> None:
    sensor = generic_sensor(model)
    assert (sensor.name, sensor.origin) == (model, "generic")
    vertical = sensor.calibration["vert_correction_rad"]
    assert -0.45 < vertical.min() < vertical.max() < 0.1
    notice = files("lidarcodec.sensors").joinpath("data", "NOTICE").read_text()
    assert "ros-drivers/velodyne" in notice
    assert "BSD 3-clause" in notice


def test_generic_tables_are_the_published_ones(data_file) -> None:
    for model, file in (("S1", "utexas"), ("S2.1", "s2.1-sztaki"), ("S3", "s3-xiesc")):
        published = find_calibration(None, data_file(f"calib_ros_64e_{file}.yaml"), [])
        assert (published.calibration.table == generic_sensor(f"HDL-64E {model}").calibration.table).all()


def test_an_unknown_model_is_refused_with_those_that_exist() -> None:
    with pytest.raises(UnknownNameError, match=r"HDL-64E S2\.1"):
        generic_sensor("HDL-64E S4")
