"""What somebody loses if these fail: the word that a recording lacks frames, or that one of raw packets is full."""

from __future__ import annotations

import json
from pathlib import Path

from mcap.writer import Writer

from lidarcodec.recording import RecordingReader, RecordingWriter
from lidarcodec.settings import StreamSettings
from tests.command_line import run_here


def test_frames_that_are_missing_between_those_of_a_recording_are_counted(tmp_path: Path) -> None:
    """`subscribe` and `fetch` said it once; the file that they left did not."""
    whole, holed = tmp_path / "whole.mcap", tmp_path / "holed.mcap"
    assert run_here("encode", "sim:city?frames=6&seed=1", whole, "--codec", "raw").returncode == 0
    with (
        whole.open("rb") as handle,
        holed.open("wb") as to,
        RecordingWriter(to, "car-7", "roof", StreamSettings(), {}) as writer,
    ):
        for number, (_, data) in enumerate(RecordingReader(handle).messages()):
            if number not in (1, 3, 4):
                writer.write(data)
    complete = json.loads(run_here("info", whole, "--json").stdout)
    assert (complete["frames"], complete["missing frames"], "longest hole" in complete) == (6, 0, False)
    found = json.loads(run_here("info", holed, "--json").stdout)
    assert (found["frames"], found["missing frames"]) == (3, 3)
    assert found["longest hole"].startswith("0.3 s, 2 frames, after 20")
    assert "missing frames           3" in run_here("info", holed).stdout


def test_what_a_file_says_steers_no_terminal_and_feigns_no_line(tmp_path: Path) -> None:
    """Its metadata could set the title of the window, clear it, and print "identical" in the name of a command."""
    hostile = "\x1b]0;title\x07\x1b[2J\r\nidentical"
    named, bag = tmp_path / f"{hostile}.mcap", tmp_path / "bag.mcap"
    with named.open("wb") as to:
        RecordingWriter(to, "car-7", "roof", StreamSettings(), {"source": hostile, hostile: hostile}).close()
    with bag.open("wb") as file:
        writer = Writer(file)
        writer.start()
        cloud = writer.register_schema("sensor_msgs/msg/PointCloud2", "ros2msg", b"")
        for topic in ("/a", f"/b{hostile}"):
            writer.add_message(writer.register_channel(topic, "cdr", cloud), 1, b"\0\1\0\0" + bytes(60), 1)
        writer.finish()
    for done in (run_here("info", named), run_here("info", bag), run_here("decode", named, tmp_path / "no" / hostile)):
        said = (done.stdout + done.stderr).splitlines()
        assert said
        assert not [line for line in said if not line.isprintable() or line.startswith("identical")], said


def test_a_recording_of_raw_packets_does_not_look_empty(tmp_path: Path) -> None:
    out = tmp_path / "drive.mcap"
    assert run_here("convert", "sim:city?frames=3", out, "--as", "packets").returncode == 0
    found = json.loads(run_here("info", out, "--json").stdout)
    assert found["frames"] is None
    assert found["raw packets"] > 900
    assert 0.2 < found["duration_s"] < 0.4
    shown = run_here("info", out).stdout
    assert "\nframes " not in shown
    assert "begins                   20" in shown
    assert f'lidarcodec info "{out}?read=packets"' in shown
    assert run_here("info", f"{out}?read=packets").returncode == 0
    assert run_here("convert", out, tmp_path / "drive.pcap").returncode == 0


def test_encode_counts_the_frames_that_are_in_the_file(tmp_path: Path) -> None:
    """It said "10 frames (4 of them left out)" of a file with 6."""
    out = tmp_path / "drive.mcap"
    words = ("--codec", "auto", "--set", "target_kbps=100", "--allow-missed")
    done = run_here("encode", "sim:city?frames=4", out, *words)
    assert done.returncode == 0, done.stderr
    kept = json.loads(run_here("info", out, "--json").stdout)["frames"]
    assert 0 < kept < 4
    assert f"{kept} frame" in done.stdout
    assert f"(and {4 - kept} left out to keep the target)" in done.stdout
