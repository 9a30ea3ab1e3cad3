"""What a user would lose: right points in a short part of a drive whose sensor sends its calibration in its packets."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lidarcodec.sensors import write_db_xml
from lidarcodec.sources import open_source
from lidarcodec.sources.captures.pcap_writer import PcapWriter
from tests import packets as made
from tests.command_line import run_here
from tests.sensors.test_status import stream


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A whole table, as it comes in 4,160 packets, and some more."""
    path = tmp_path_factory.mktemp("sent") / "drive.pcap"
    packets = made.turning(4300)
    with path.open("wb") as file:
        PcapWriter(file).write_all(
            [
                packet._replace(payload=packet.payload[:1200] + data[1200:])
                for packet, data in zip(packets, stream(4300), strict=True)
            ]
        )
    return path


@pytest.mark.parametrize("name", ["part.pcap", "bag", "part.mcap"])
def test_a_part_too_short_for_the_table_has_it_beside(tmp_path: Path, capture: Path, name: str) -> None:
    words = ["--as", "packets"] if name.endswith(".mcap") else []
    assert run_here("convert", capture, tmp_path / name, "--frames", 2, *words).returncode == 0
    with open_source(capture) as whole, open_source(tmp_path / name) as part:
        assert whole.sensor.origin == "stream"
        assert np.array_equal(whole.sensor.calibration.table, part.sensor.calibration.table)


def test_a_whole_drive_needs_no_other_file(tmp_path: Path, capture: Path) -> None:
    assert run_here("convert", capture, tmp_path / "all.pcap").returncode == 0
    assert [path.name for path in tmp_path.iterdir()] == ["all.pcap"]


def test_a_part_has_its_table_though_an_older_output_left_another(tmp_path: Path, capture: Path) -> None:
    """A table beside a capture counts more than the one in its packets: points would be those of another car."""
    write_db_xml(made.sensor(), tmp_path / "all_db.xml")
    refused = run_here("convert", capture, tmp_path / "all.pcap")
    assert (refused.returncode, "another calibration" in refused.stderr) == (2, True)


def test_parts_that_cut_made_have_it_where_they_are_too_short(tmp_path: Path, capture: Path) -> None:
    """Their clouds were those of a generic calibration."""
    assert run_here("cut", capture, tmp_path / "part.pcap", "--every", 0.3).returncode == 0
    parts = sorted(tmp_path.glob("*.pcap"))
    assert len(parts) >= 3
    for path in parts:
        with open_source(capture) as whole, open_source(path) as part:
            assert np.array_equal(whole.sensor.calibration.table, part.sensor.calibration.table)
    assert run_here("join", *parts, tmp_path / "again.pcap").returncode == 0
    assert (tmp_path / "again.pcap").read_bytes() == capture.read_bytes()
    assert run_here("cut", capture, tmp_path / "all.pcap", "--from", 0).returncode == 0
    assert not (tmp_path / "all_db.xml").exists()
