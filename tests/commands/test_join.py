"""What somebody loses if these fail: frames between two parts, or a drive that was mixed with another."""

from __future__ import annotations

import re
import struct
from ipaddress import ip_address
from pathlib import Path

import pytest

from lidarcodec import wire
from lidarcodec.recording import RecordingReader, RotatingRecorder
from lidarcodec.settings import StreamSettings
from lidarcodec.sources import open_source
from tests.command_line import run_here, the_one_line
from tests.drives import simulated
from tests.packets import payloads_in
from tests.recording.damaged import damaged_message
from tests.sources import captures as c

FRAMES = 6
SOURCE = f"sim:city?frames={FRAMES}"


def messages_in(path: Path) -> list[bytes]:
    with path.open("rb") as handle:
        return [data for _, data in RecordingReader(handle).messages()]


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a capture."""
    folder = tmp_path_factory.mktemp("drive")
    return simulated(SOURCE, folder / "drive.pcap")


@pytest.mark.parametrize(
    "words",
    [
        pytest.param(("encode", "--codec", "zstd"), marks=pytest.mark.sweep),
        pytest.param(("encode", "--codec", "predictive", "--set", "motion=true"), marks=pytest.mark.sweep),
        pytest.param(("encode", "--set", "framing=revolution"), marks=pytest.mark.sweep),
        ("encode", "--set", "framing=packets:100", "--with-clouds"),
        ("convert", "--as", "packets"),
        pytest.param(("convert", "--as", "recording", "--set", "framing=revolution"), marks=pytest.mark.sweep),
    ],
)
def test_parts_joined_are_the_whole(drive: Path, tmp_path: Path, words: tuple[str, ...]) -> None:
    command, *options = words
    first, second, third = (tmp_path / f"{number}.mcap" for number in range(3))
    for part, which in ((first, ("--frames", 2)), (second, ("--skip", 2, "--frames", 1)), (third, ("--skip", 3))):
        assert run_here(command, drive, part, *options, *which).returncode == 0
    out = tmp_path / "out.mcap"
    result = run_here("join", first, second, third, out)
    assert result.returncode == 0, result.stderr
    assert payloads_in(out) == payloads_in(drive)
    assert messages_in(out) == [data for part in (first, second, third) for data in messages_in(part)]
    with out.open("rb") as joined, first.open("rb") as part:
        found, before = RecordingReader(joined), RecordingReader(part)
        assert found.metadata == before.metadata | {"joined": "3"}
        assert {one.topic for one in found.channels.values()} == {one.topic for one in before.channels.values()}
    if command == "encode":
        assert run_here("verify", out, drive).returncode == 0
    assert run_here("decode", out, tmp_path / "back.pcap").returncode == 0
    assert payloads_in(tmp_path / "back.pcap") == payloads_in(drive)


@pytest.fixture(scope="module")
def parts(drive: Path) -> Path:
    """A folder with parts: a (0-1), b (2-3), c (3-5), coarse (2-3), other (another drive), rows (revolutions)."""
    folder = drive.parent
    for name, which in (
        ("a", ("--frames", 2)), ("b", ("--skip", 2, "--frames", 2)), ("c", ("--skip", 3)),
        ("coarse", ("--skip", 2, "--set", "max_error_m=0.02")), ("turns", ("--set", "framing=revolution")),
    ):  # fmt: skip
        assert run_here("encode", drive, folder / f"{name}.mcap", *which).returncode == 0
    assert run_here("encode", "sim:road?frames=4", folder / "other.mcap", "--skip", 2).returncode == 0
    assert run_here("convert", drive, folder / "bare.mcap", "--as", "packets").returncode == 0
    (folder / "empty.mcap").write_bytes((folder / "a.mcap").read_bytes()[:700])
    (folder / "cut.mcap").write_bytes((folder / "a.mcap").read_bytes()[:-40_000])
    return folder


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        (("b", "a"), 2, "without overlap"),
        (("b", "turns"), 2, "PART.mcap --skip 4` with the same settings"),
        (("b", "c"), 2, "without overlap"),
        (("a", "a"), 2, "without overlap"),
        (("turns", "turns"), 2, "without overlap"),
        (("bare", "bare"), 2, "without overlap"),
        (("a", "c"), 2, "frames 2 to 2 are missing"),
        (("a", "other"), 2, "differ in source"),
        (("a", "coarse"), 2, "differ in settings (max_error_m: null and 0.02)"),
        (("a", "empty"), 1, "no message"),
        (("a",), 2, "two parts"),
    ],
)
def test_what_does_not_belong_together_is_refused(
    parts: Path, tmp_path: Path, words: tuple[str, ...], code: int, says: str
) -> None:
    out = tmp_path / "out.mcap"
    result = run_here("join", *(parts / f"{word}.mcap" for word in words), out)
    assert result.returncode == code
    assert says in result.stderr.splitlines()[-1]
    assert not list(tmp_path.iterdir())


def test_what_cut_took_apart_is_joined_with_every_message_once(parts: Path, tmp_path: Path) -> None:
    """A part begins with the key frame that its frames need, which the part before has, too."""
    drive, first, second, out = (tmp_path / f"{name}.mcap" for name in ("drive", "first", "second", "out"))
    assert run_here("encode", SOURCE, drive, "--with-clouds").returncode == 0
    assert run_here("cut", drive, first, "--frames", 3).returncode == 0
    assert run_here("cut", drive, second, "--skip", 3).returncode == 0
    assert len(messages_in(second)) == FRAMES
    done = run_here("join", first, second, out)
    assert done.returncode == 0, done.stderr
    assert "6 messages that two parts have, written once" in done.stdout
    assert messages_in(out) == messages_in(drive)
    with out.open("rb") as joined, drive.open("rb") as whole:
        copies = [
            [(channel.topic, stored.log_time, stored.data()) for channel, stored in RecordingReader(one).everything()]
            for one in (joined, whole)
        ]
    assert sorted(copies[0]) == sorted(copies[1])
    refused = run_here("join", second, first, out, "--force")
    assert (refused.returncode, "in order" in the_one_line(refused)) == (2, True)


def test_a_gap_is_joined_if_that_is_meant_and_nothing_is_replaced(parts: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.mcap"
    assert run_here("join", parts / "a.mcap", parts / "c.mcap", out, "--allow-gap").returncode == 0
    assert len(messages_in(out)) == 5
    refused = run_here("join", parts / "a.mcap", parts / "b.mcap", out)
    assert (refused.returncode, "--force" in the_one_line(refused)) == (2, True)
    assert run_here("join", parts / "a.mcap", parts / "b.mcap", out, "--force").returncode == 0
    assert len(messages_in(out)) == 4
    refused = run_here("join", out, parts / "c.mcap", out, "--force")
    assert (refused.returncode, "another name" in the_one_line(refused)) == (2, True)
    assert run_here("join", parts / "a.mcap", parts / "a.pcap", tmp_path / "x.mcap").returncode == 2


def test_a_part_that_was_cut_gives_what_is_whole_and_says_so(
    parts: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    out = tmp_path / "out.mcap"
    refused = run_here("join", parts / "b.mcap", parts / "cut.mcap", out)
    assert (refused.returncode, "cut.mcap was cut" in refused.stderr) == (1, True)
    assert not out.exists()
    assert run_here("join", parts / "cut.mcap", parts / "b.mcap", out, "--allow-gap").returncode == 0
    assert "cut.mcap was cut" in caplog.text
    assert len(messages_in(out)) == 3


def test_a_part_that_is_damaged_is_joined_only_if_that_is_meant(parts: Path, tmp_path: Path) -> None:
    """One of its messages was left out, and the exit code was 0."""
    data = bytearray((parts / "a.mcap").read_bytes())
    data[len(data) * 3 // 4] ^= 0xFF
    hurt, out = tmp_path / "hurt.mcap", tmp_path / "out.mcap"
    hurt.write_bytes(data)
    refused = run_here("join", hurt, parts / "b.mcap", out)
    assert refused.returncode == 1
    assert "hurt.mcap is damaged, and 1 of its chunks are lost" in refused.stderr
    assert not out.exists()
    assert run_here("join", hurt, parts / "b.mcap", out, "--allow-gap").returncode == 0
    assert 0 < len(messages_in(out)) < 4


def test_a_part_with_a_damaged_message_is_joined_only_if_that_is_meant(parts: Path, tmp_path: Path) -> None:
    """It was copied without a word."""
    hurt, out = damaged_message(parts / "a.mcap", tmp_path / "hurt.mcap", 1), tmp_path / "out.mcap"
    refused = run_here("join", hurt, parts / "b.mcap", out)
    assert (refused.returncode, "has 1 message that cannot be decoded" in refused.stderr) == (1, True)
    assert not out.exists()
    assert run_here("join", hurt, parts / "b.mcap", out, "--allow-gap").returncode == 0
    assert len(messages_in(out)) == 4


def test_a_file_of_a_live_recording_that_was_forgotten_is_noticed(drive: Path, tmp_path: Path) -> None:
    """A live stream leaves frames out, but fewer than a file has."""
    words = ("--codec", "raw", "--set", "key_interval=1")
    assert run_here("encode", drive, tmp_path / "coded.mcap", *words).returncode == 0
    data = messages_in(tmp_path / "coded.mcap")
    for part in (data[:2], data[2:4], data[4:]):
        recorder = RotatingRecorder(tmp_path, "car", "roof")
        assert all(map(recorder.write, part))
        recorder.close()
    first, second, third = sorted(tmp_path.glob("car_roof_*.mcap"))
    refused = run_here("join", first, third, tmp_path / "out.mcap")
    assert (refused.returncode, "frames 2 to 3 are missing" in refused.stderr) == (2, True)
    assert run_here("join", first, third, tmp_path / "out.mcap", "--allow-gap").returncode == 0
    assert run_here("join", first, second, third, tmp_path / "all.mcap").returncode == 0
    assert messages_in(tmp_path / "all.mcap") == data


@pytest.mark.parametrize("tail", [bytes(4096), b"\1" * 30], ids=["zeros", "cut"])
def test_a_capture_whose_end_is_lost_is_joined_only_if_that_is_meant(drive: Path, tmp_path: Path, tail: bytes) -> None:
    """As where a machine lost its power: the next part lay behind the zeros, where no reader found it."""
    first, second, out = tmp_path / "first.pcap", tmp_path / "second.pcap", tmp_path / "out.pcap"
    assert run_here("convert", drive, first, "--frames", 3).returncode == 0
    assert run_here("convert", drive, second, "--skip", 3).returncode == 0
    first.write_bytes(first.read_bytes() + tail)
    refused = run_here("join", first, second, out)
    assert (refused.returncode, "is damaged: record 1077 " in refused.stderr) == (1, True)
    assert not out.exists()
    assert run_here("join", first, second, out, "--allow-gap").returncode == 0
    assert payloads_in(out) == payloads_in(drive)


def test_a_capture_that_was_cut_off_is_told_of_in_the_same_words_by_all_commands(drive: Path, tmp_path: Path, caplog):
    """`cut` called it damaged, all other commands truncated."""
    short = tmp_path / "short.pcap"
    short.write_bytes(drive.read_bytes()[:400_500])
    payloads_in(short)
    assert run_here("cut", short, tmp_path / "cut.pcap", "--to", "0.02").returncode == 0
    first, second = (one for one in caplog.messages if "calibration" not in one)
    assert first == second
    assert re.search(r"short.pcap is truncated: record \d+ has \d+ of its bytes", first)


def test_files_of_a_live_recording_are_joined_though_settings_changed(drive: Path, tmp_path: Path) -> None:
    whole = []
    for which, settings in (
        (("--frames", 3), StreamSettings()),
        (("--skip", 3), StreamSettings(codec="zstd", max_error_m=0.01)),
    ):
        coded = tmp_path / f"coded-{settings.codec}.mcap"
        words = ("--codec", settings.codec, "--set", f"max_error_m={settings.max_error_m or 0}")
        assert run_here("encode", drive, coded, *which, *words).returncode == 0
        part = messages_in(coded)
        whole += part
        recorder = RotatingRecorder(tmp_path, "car", "roof", settings)
        for data in part:
            assert recorder.write(data)
        recorder.close()
    files = sorted(tmp_path.glob("car_roof_*.mcap"))
    assert run_here("join", *files, tmp_path / "out.mcap").returncode == 0
    assert messages_in(tmp_path / "out.mcap") == whole
    refused = run_here("join", *reversed(files), tmp_path / "no.mcap")
    assert "without overlap" in the_one_line(refused)
    assert all(wire.peek(data).frame_index == number for number, data in enumerate(whole))


@pytest.mark.parametrize("address", ["192.168.1.200", "192.168.3.43"])
def test_captures_of_two_sensors_are_joined_with_a_warning_that_says_how_to_read_both(
    tmp_path: Path, address, caplog
) -> None:
    """Else the second is only a number of packets of another stream, and nothing says where it is."""
    puck = (struct.pack("<HH", 0xEEFF, 0) + bytes(96)) * 12 + bytes(4) + b"\x37\x22"
    theirs, ours, both = (tmp_path / f"{name}.pcap" for name in ("theirs", "ours", "both"))
    first = [c.frame(c.payload(k)) for k in range(20)]
    whole = c.pcap(first + [c.frame(puck, source=ip_address(address).packed)] * 3)
    ours.write_bytes(c.pcap(first))
    theirs.write_bytes(whole[:24] + whole[len(c.pcap(first)) :])
    assert run_here("join", ours, theirs, both).returncode == 0
    (told,) = caplog.messages
    assert f"{ours} is of hdl64e at 192.168.3.43" in told
    assert f"{theirs} is of vlp16 at {address}" in told
    if address == "192.168.3.43":
        assert "lidarcodec cut" in told
        return
    assert f'"{both}?src={address}" as the second' in told
    with open_source(f"{both}?src={address}") as source:
        assert [source.sensor.model for _ in source.packets()] == ["vlp16"] * 3


def test_captures_are_joined_record_by_record_with_their_calibration(drive: Path, tmp_path: Path, caplog) -> None:
    first, second, out = (tmp_path / f"{name}.pcap" for name in ("first", "second", "out"))
    assert run_here("convert", drive, first, "--frames", 2).returncode == 0
    assert run_here("convert", drive, second, "--skip", 2).returncode == 0
    refused = run_here("join", second, first, out)
    assert (refused.returncode, "without overlap" in the_one_line(refused)) == (2, True)
    assert run_here("join", first, second, out).returncode == 0
    assert not caplog.messages
    assert out.read_bytes() == drive.read_bytes()
    assert (tmp_path / "out_db.xml").read_bytes() == (tmp_path / "first_db.xml").read_bytes()
    out.unlink()
    assert run_here("join", first, second, out).returncode == 0, "the same calibration is there already"
    out.unlink()
    (tmp_path / "out_db.xml").write_text("another")
    refused = run_here("join", first, second, out)
    assert (refused.returncode, "out_db.xml exists" in the_one_line(refused)) == (2, True)
    assert not out.exists()
    (tmp_path / "second_db.xml").write_text("another")
    refused = run_here("join", first, second, tmp_path / "no.pcap")
    assert (refused.returncode, "differ: the captures" in the_one_line(refused)) == (2, True)
    (tmp_path / "text.pcap").write_text("no capture at all, but long enough")
    assert run_here("join", first, tmp_path / "text.pcap", tmp_path / "no.pcap").returncode == 1
    assert not (tmp_path / "no.pcap").exists()
