"""`encode && verify && rm` loses nothing: what we write is read whole, what is read is never replaced, and a source
that gives only a part of what it holds is not taken for whole."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest

from lidarcodec.sources.captures.pcap_writer import PcapWriter
from tests.command_line import run_here
from tests.packets import turning

HEAD, RECORD = 24, 16


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    path = tmp_path / "drive.pcap"
    with path.open("wb") as handle:
        writer = PcapWriter(handle)
        for packet in turning(700):
            writer.write(packet)
    return path


@pytest.mark.sweep
def test_a_recording_of_many_small_messages_is_read_whole(drive: Path, tmp_path: Path) -> None:
    """Each message is a chunk of its own: 700 of a packet each were more than a limit on records let pass."""
    recording = tmp_path / "small.mcap"
    options = ("--codec", "zstd", "--set", "framing=packets:1")
    assert run_here("encode", drive, recording, *options).returncode == 0
    result = run_here("verify", recording, drive)
    assert result.returncode == 0, result.stdout + result.stderr
    assert "700, identical" in result.stdout


def test_a_folder_that_is_read_is_not_replaced_nor_what_lies_in_it(drive: Path, tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    assert run_here("convert", drive, bag).returncode == 0
    before = {path.name: path.read_bytes() for path in bag.iterdir()}
    (recorded,) = bag.glob("*.mcap")
    for source, out in ((bag, bag), (recorded, bag), (bag, recorded)):
        command = "encode" if out.suffix else "convert"
        result = run_here(command, source, out, "--force", "--frames", "1")
        assert result.returncode == 2, result.stdout + result.stderr
        assert "is the input" in result.stderr
    assert {path.name: path.read_bytes() for path in bag.iterdir()} == before


def test_the_calibration_of_what_is_read_stays_as_it_is(drive: Path, tmp_path: Path, data_file) -> None:
    beside = tmp_path / "drive_db.xml"
    beside.write_bytes(Path(data_file("kitti_hdl64e_s2_recovered_db.xml")).read_bytes() + b"<!-- notes -->\n")
    before = beside.read_bytes()
    assert run_here("convert", drive, tmp_path / "drive.mcap", "--as", "rosbag", "--force").returncode == 0
    assert beside.read_bytes() == before
    other = data_file("calib_ros_64e_utexas.yaml")
    given = ("--as", "rosbag", "--force", "--calibration", other)
    assert run_here("convert", drive, tmp_path / "drive.mcap", *given).returncode == 2
    assert beside.read_bytes() == before


@pytest.mark.parametrize("what", ["damaged", "another port", "another length"])
def test_verify_fails_where_the_source_gives_only_a_part_of_what_it_holds(
    drive: Path, tmp_path: Path, what: str
) -> None:
    data = bytearray(drive.read_bytes())
    at, number = HEAD, 0
    while at < len(data):
        (size,) = struct.unpack_from("<I", data, at + 8)
        if what == "damaged" and number == 400:
            struct.pack_into("<I", data, at + 8, 0x7FFFFFFF)
            break
        if what == "another port" and number >= 600:
            struct.pack_into(">H", data, at + RECORD + 14 + 20 + 2, 2369)
            struct.pack_into(">H", data, at + RECORD + 14 + 20 + 6, 0)
        if what == "another length" and number >= 600:
            struct.pack_into(">HH", data, at + RECORD + 14 + 20 + 4, 1106 + 8, 0)
        at, number = at + RECORD + size, number + 1
    hurt = tmp_path / "hurt.pcap"
    hurt.write_bytes(data)
    recording = tmp_path / "hurt.mcap"
    assert run_here("encode", hurt, recording, "--codec", "zstd").returncode == 0
    result = run_here("verify", recording, hurt)
    assert result.returncode == 1, result.stdout + result.stderr
    assert "the source" in result.stdout
    assert run_here("verify", recording, hurt, "--allow-part").returncode == 0
