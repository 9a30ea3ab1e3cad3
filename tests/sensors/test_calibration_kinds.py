"""What somebody loses if these fail: the word that the file is another sensor's, or that a model gives no points."""

from __future__ import annotations

import pytest

from lidarcodec.errors import CalibrationError
from lidarcodec.sensors import db_xml, find_sensor, generic_sensor, hesai_csv, ros_yaml
from lidarcodec.sensors.models.table import sensor_named
from tests.command_line import run_here
from tests.sensors.ouster_packets import as_json, flat_metadata


def files():
    hdl, hesai = generic_sensor("HDL-64E S2").calibration, sensor_named("xt32m").generic_sensor.calibration
    return {
        "db.xml": db_xml.text(hdl).encode(),
        "ROS": ros_yaml.text(hdl).encode(),
        "Hesai": hesai_csv.text(hesai).encode(),
        "Ouster": as_json(flat_metadata()),
    }


@pytest.mark.parametrize(
    ("kind", "model", "said"),
    [
        ("Ouster", "vlp16", "is the metadata of an Ouster"),
        ("Ouster", "hdl64e", "is the metadata of an Ouster"),
        ("Ouster", "xt32m", "is the metadata of an Ouster"),
        ("Hesai", "vlp16", "is the angle correction file of a Hesai"),
        ("Hesai", "os1-128", "is the angle correction file of a Hesai"),
        ("ROS", "xt32m", "is the ROS calibration of a Velodyne"),
        ("db.xml", "os1-128", "is the db.xml of a Velodyne"),
    ],
)
def test_a_file_of_another_maker_is_named_as_what_it_is(tmp_path, kind, model, said):
    """An Ouster's JSON for a Puck: "it lacks the list 'lasers', which every ROS calibration has"."""
    path = tmp_path / "given"
    path.write_bytes(files()[kind])
    with pytest.raises(CalibrationError, match=said):
        find_sensor(None, path, [], model)


@pytest.mark.parametrize("name", ["out.ply", "out.mcap", "folder"])
def test_a_model_that_gives_no_points_is_an_error_and_no_empty_file(tmp_path, name):
    capture, out = tmp_path / "drive.pcap", tmp_path / name
    assert run_here("simulate", "sim:road", capture, "--frames", 1).returncode == 0
    form = "clouds" if name.endswith("mcap") else "ply"
    done = run_here("convert", capture, out, "--as", form, "--model", "vlp16")
    assert done.returncode == 1
    assert "is one of the model vlp16, so there are no points" in done.stderr
    assert not out.exists()


def test_a_recording_takes_the_calibration_of_its_own_sensor(tmp_path):
    """Messages of a Hesai were given Hesai's file: "it lacks the list 'lasers', which every ROS calibration has"."""
    recording, table = tmp_path / "a.mcap", tmp_path / "own.csv"
    made = run_here("encode", "sim:road?sensor=vlp16", recording, "--frames", 1)
    assert made.returncode == 0, made.stderr
    table.write_bytes(files()["Hesai"])
    refused = run_here("convert", recording, tmp_path / "a.ply", "--calibration", table)
    assert "is the angle correction file of a Hesai, but the sensor is a Velodyne VLP-16" in refused.stderr
    own = tmp_path / "own.yaml"
    own.write_text(ros_yaml.text(sensor_named("vlp16").generic_sensor.calibration), encoding="utf-8")
    done = run_here("convert", recording, tmp_path / "a.ply", "--calibration", own)
    assert done.returncode == 0, done.stderr
    assert "of its own" not in done.stderr
