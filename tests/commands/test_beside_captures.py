"""What lies beside a capture and its points need goes with it: else who deletes the long one has packets alone."""

from dataclasses import replace

import numpy as np
import pytest

from lidarcodec import read_frames
from lidarcodec.sensor_model import CALIBRATION_FIELDS, Calibration
from lidarcodec.sensors import db_xml, hesai_csv
from lidarcodec.sources import open_source
from tests.command_line import run_here
from tests.conftest import ROOT

HESAI = b"Laser id,Elevation,Azimuth\n1,15,-1\n"


def points(path):
    with open_source(path) as source:
        assert source.sensor.origin == "beside"
    return next(iter(read_frames(path))).cloud()


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """A capture of an Ouster, with its metadata beside it."""
    folder = tmp_path_factory.mktemp("drive")
    assert run_here("simulate", "sim:road?frames=3&sensor=os0-32", folder / "drive.pcap").returncode == 0
    assert (folder / "drive.json").is_file()
    return folder / "drive.pcap"


@pytest.mark.parametrize("name", ["drive.json", "drive_of_the_roof.json"])
def test_the_metadata_of_an_ouster_goes_with_each_part_and_with_what_is_joined(drive, tmp_path, name):
    (tmp_path / "drive.pcap").write_bytes(drive.read_bytes())
    (tmp_path / name).write_bytes(drive.with_suffix(".json").read_bytes())
    parts, back = tmp_path / "parts", tmp_path / "back"
    parts.mkdir()
    back.mkdir()
    cut = run_here("cut", tmp_path / "drive.pcap", parts / "p.pcap", "--every", 0.1)
    assert cut.returncode == 0, cut.stderr
    assert "metadata in" in cut.stdout
    made = sorted(parts.glob("*.pcap"))
    assert len(made) == 3
    for one in made:
        assert len(points(one)) > 1000
    joined = run_here("join", *made, back / "drive.pcap")
    assert joined.returncode == 0, joined.stderr
    assert (back / "drive.pcap").read_bytes() == drive.read_bytes()
    assert np.array_equal(points(back / "drive.pcap"), points(drive))


def test_calibrations_of_any_form_go_with_a_part_and_points_do_not(drive, tmp_path):
    data = drive.read_bytes()
    for name, text in (("a.csv", HESAI), ("b.yaml", b"lasers: []\n"), ("c.csv", b"x_m,y_m,z_m\n1,2,3\n")):
        (tmp_path / f"{name[0]}.pcap").write_bytes(data)
        (tmp_path / name).write_bytes(text)
    for name, beside in (("a", ["a-cut.csv"]), ("b", ["b-cut.yaml"]), ("c", [])):
        assert run_here("cut", tmp_path / f"{name}.pcap", tmp_path / f"{name}-cut.pcap", "--to", 0.1).returncode == 0
        found = [one.name for one in tmp_path.glob(f"{name}-cut.*") if one.suffix != ".pcap"]
        assert found == beside


def test_a_calibration_for_a_whole_folder_goes_with_a_part_elsewhere(drive, tmp_path):
    (tmp_path / "drive.pcap").write_bytes(drive.read_bytes())
    table = (ROOT / "lidarcodec" / "cli.py").read_bytes()  # what is in it does not matter
    (tmp_path / "db.xml").write_bytes(table)
    (tmp_path / "parts").mkdir()
    assert run_here("cut", tmp_path / "drive.pcap", tmp_path / "parts" / "p.pcap", "--to", 0.1).returncode == 0
    assert (tmp_path / "parts" / "p_db.xml").read_bytes() == table


@pytest.mark.parametrize("sensor", ["hdl64e", "os0-32", "vlp16", "pandar40p"])
def test_the_packets_of_a_recording_come_back_with_what_their_points_need(tmp_path, sensor):
    """Else clouds of the capture are off by up to half a metre, and an Ouster's has none."""
    first, drive = tmp_path / "first.pcap", tmp_path / "drive.pcap"
    assert run_here("simulate", f"sim:road?frames=2&sensor={sensor}", first).returncode == 0
    with open_source(first) as source:
        known = source.sensor
    words = ()
    if sensor in ("vlp16", "pandar40p"):
        table = known.calibration.table.copy()
        table[list(CALIBRATION_FIELDS).index("rot_correction_rad")] += 50
        turned = replace(known, calibration=Calibration(table))
        ending = "_db.xml" if sensor == "vlp16" else ".csv"
        own = tmp_path / f"own{ending}"
        text = db_xml.text if sensor == "vlp16" else hesai_csv.text
        own.write_text(text(turned.calibration))
        words = ("--calibration", own)
    assert run_here("encode", first, tmp_path / "drive.mcap", *words).returncode == 0
    before = next(iter(read_frames(tmp_path / "drive.mcap")))
    done = run_here("decode", tmp_path / "drive.mcap", drive)
    assert done.returncode == 0, done.stderr
    assert np.array_equal(points(drive), before.cloud())
    assert run_here("decode", tmp_path / "drive.mcap", drive, "--force").returncode == 0, "it is there already"
    copied = run_here("convert", drive, tmp_path / "copy.pcap")
    assert copied.returncode == 0, copied.stderr
    assert np.array_equal(points(tmp_path / "copy.pcap"), before.cloud())


def test_another_calibration_beside_a_capture_is_not_replaced_without_a_word(drive, tmp_path):
    assert run_here("encode", drive, tmp_path / "drive.mcap", "--frames", 1).returncode == 0
    (tmp_path / "out.json").write_text("{}")
    done = run_here("decode", tmp_path / "drive.mcap", tmp_path / "out.pcap")
    assert done.returncode == 2
    assert "out.json exists" in done.stderr
    assert not (tmp_path / "out.pcap").exists()
    assert run_here("decode", tmp_path / "drive.mcap", tmp_path / "out.pcap", "--force").returncode == 0
    assert len(points(tmp_path / "out.pcap")) > 1000
