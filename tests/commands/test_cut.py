"""`cut`: parts of recordings decode alone, parts of captures are the same packets, and `join` puts them together."""

import json
import re

import pytest

from lidarcodec.recording import RecordingReader
from lidarcodec.wire import unpack
from tests.command_line import run_here, the_one_line
from tests.commands.test_json import check
from tests.drives import simulated
from tests.recording.damaged import damaged_message


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """Eight frames, a key frame every third, with their points; and their capture."""
    folder = tmp_path_factory.mktemp("drive")
    capture, recording = folder / "drive.pcap", folder / "drive.mcap"
    simulated("sim:city", capture, "--frames", 8)
    words = ("--codec", "zstd", "--set", "key_interval=3", "--with-clouds")
    assert run_here("encode", capture, recording, *words).returncode == 0
    return folder


def cut(*words):
    result = run_here("cut", *words, "--json")
    assert result.returncode == 0, result.stderr
    found = json.loads(result.stdout)
    check("cut", found)
    return found


def messages(path):
    with path.open("rb") as handle:
        return list(RecordingReader(handle).messages())


def test_a_part_begins_with_the_key_frame_that_it_needs_and_decodes_alone(drive, tmp_path):
    found = cut(drive / "drive.mcap", tmp_path / "a.mcap", "--skip", 4, "--frames", 2)
    assert (found["earlier_frames"], found["messages"]) == (1, 6)  # three frames, and the points of each
    assert messages(tmp_path / "a.mcap") == messages(drive / "drive.mcap")[3:6]
    verified = run_here("verify", tmp_path / "a.mcap", drive / "drive.pcap", "--json", "--allow-part")
    assert json.loads(verified.stdout)["identical_packets"] > 1000
    cut(drive / "drive.mcap", tmp_path / "b.mcap", "--from", "0.35", "--to", "0.65")
    assert messages(tmp_path / "b.mcap") == messages(drive / "drive.mcap")[3:7]


@pytest.mark.sweep
def test_who_wants_an_exact_beginning_is_told_the_command(drive, tmp_path):
    out = tmp_path / "a.mcap"
    told = run_here("cut", drive / "drive.mcap", out, "--skip", 4, "--frames", 2).stdout
    words = re.search(r"To begin exactly: `lidarcodec (.*)`", told)[1].split()
    assert words[3:] == ["--skip", "4", "--frames", "2", "--codec", "pcodec", "--force"]
    assert run_here(*words).returncode == 0
    assert [unpack(data).frame_index for _, data in messages(out)] == [4, 5]


def test_parts_joined_again_are_the_recording(drive, tmp_path):
    found = cut(drive / "drive.mcap", tmp_path / "p.mcap", "--every", 0.3)
    assert [one.rpartition("-")[2] for one in found["outputs"]] == ["000.mcap", "001.mcap", "002.mcap"]
    assert [len(messages(tmp_path / f"p-00{n}.mcap")) for n in range(3)] == [3, 3, 2]
    assert run_here("join", *found["outputs"], tmp_path / "back.mcap").returncode == 0
    assert messages(tmp_path / "back.mcap") == messages(drive / "drive.mcap")


def test_a_damaged_message_is_not_copied_without_a_word(drive, tmp_path, caplog):
    hurt = damaged_message(drive / "drive.mcap", tmp_path / "hurt.mcap", 2)
    cut(hurt, tmp_path / "a.mcap", "--frames", 4)
    assert "copied as they are, though damaged: 1 message" in caplog.text
    assert messages(tmp_path / "a.mcap") == messages(hurt)[:4]


def test_packets_and_the_calibration_beside_them_are_copied(drive, tmp_path):
    found = cut(drive / "drive.pcap", tmp_path / "p.pcap", "--every", 0.25)
    assert len(found["outputs"]) == len(found["beside"]) == 4
    assert run_here("join", *found["outputs"], tmp_path / "back.pcap").returncode == 0
    assert (tmp_path / "back.pcap").read_bytes() == (drive / "drive.pcap").read_bytes()
    part = cut(drive / "drive.pcap", tmp_path / "a.pcap", "--from", "0.25", "--to", "0.5")
    assert (tmp_path / "a.pcap").read_bytes() == (tmp_path / "p-001.pcap").read_bytes()
    assert 860 <= part["packets"] <= 870
    assert (tmp_path / "a_db.xml").read_bytes() == (drive / "drive_db.xml").read_bytes()


@pytest.mark.parametrize("command", ["cut", "convert"])
def test_a_packet_with_a_wrong_time_ends_no_part(drive, tmp_path, command):
    """All that came after it was left out, without a word, with exit code 0."""
    data = bytearray((drive / "drive.pcap").read_bytes())
    size = 16 + int.from_bytes(data[24 + 8 : 24 + 12], "little")
    at = 24 + 600 * size
    data[at : at + 4] = (int.from_bytes(data[at : at + 4], "little") + 3600).to_bytes(4, "little")
    (tmp_path / "odd.pcap").write_bytes(data)
    span = ("--from", "0.05", "--to", "0.5")
    sizes = []
    for name, source in (("a", drive / "drive.pcap"), ("b", tmp_path / "odd.pcap")):
        done = run_here(command, source, tmp_path / f"{name}.pcap", *span)
        assert done.returncode == 0, done.stderr
        sizes.append((tmp_path / f"{name}.pcap").stat().st_size)
    assert sizes[0] - sizes[1] == size


def test_recorded_packets_are_cut_by_time(drive, tmp_path):
    assert run_here("convert", drive / "drive.pcap", tmp_path / "bare.mcap", "--as", "packets").returncode == 0
    assert cut(tmp_path / "bare.mcap", tmp_path / "a.mcap", "--from", "0.15")["messages"] >= 6
    refused = run_here("cut", tmp_path / "bare.mcap", tmp_path / "b.mcap", "--frames", 1)
    assert refused.returncode == 2
    assert "has packets" in the_one_line(refused)


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        (["drive.mcap", "a.mcap"], 2, "nothing to cut"),
        (["drive.mcap", "a.pcap", "--from", "1"], 2, "the same ending"),
        (["drive.pcap", "a.pcap", "--frames", "1"], 2, "cut a capture by time"),
        (["drive.mcap", "a.mcap", "--from", "99"], 1, "no frame from 99"),
        (["drive.mcap", "drive.mcap", "--from", "1", "--force"], 2, "another name"),
    ],
)
def test_what_cannot_be_cut_is_reported_and_nothing_is_written(drive, tmp_path, words, code, says):
    source, out = drive / words[0], (drive if words[1] == "drive.mcap" else tmp_path) / words[1]
    before = (drive / "drive.mcap").read_bytes()
    result = run_here("cut", source, out, *words[2:])
    assert result.returncode == code
    assert says in the_one_line(result)
    assert list(tmp_path.iterdir()) == []
    assert (drive / "drive.mcap").read_bytes() == before
