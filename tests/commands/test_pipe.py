"""What a pipeline would lose if these fail: frames, without a word, or its end."""

from __future__ import annotations

import io
import json
import os
import signal
import struct
import threading
from pathlib import Path

import numpy as np
import pytest

from lidarcodec import wire
from lidarcodec.commands.pipe import inputs
from lidarcodec.commands.pipe.pipe import run
from lidarcodec.errors import SettingsError, SourceError
from lidarcodec.recording import RecordingReader
from lidarcodec.sources import open_source
from lidarcodec.sources.captures.pcap_writer import PcapWriter
from tests import packets as made
from tests.command_line import run_here
from tests.commands.test_convert_messages import written
from tests.packets import payloads_in
from tests.recording.damaged import damaged_message
from tests.transport.test_contract import eventually

PACKETS = made.turning(1044)


@pytest.fixture(scope="module")
def capture(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("captured") / "drive.pcap"
    with path.open("wb") as file:
        PcapWriter(file).write_all(PACKETS)
    return path


@pytest.fixture(scope="module")
def recording(tmp_path_factory) -> Path:
    return written(tmp_path_factory.mktemp("recorded") / "drive.mcap")


def piped(given: Path | None, out: Path, form: str, *, spec: str = "-", codec: str | None = None, **options) -> None:
    """Run the command with files as standard input and output."""
    with (given or Path(os.devnull)).open("rb") as read, out.open("wb") as write:
        standard = (read.fileno(), write.fileno())
        of_packets = options.get("calibration"), options.get("model")
        run(spec, form, codec, [], options.get("frames"), *of_packets, as_json=True, standard=standard)


def messages_in(path: Path) -> list[bytes]:
    with path.open("rb") as file:
        return list(inputs.messages(inputs.Input(file.fileno(), lambda: False)))


def test_a_capture_becomes_messages_a_recording_and_packets_again(tmp_path, capture, capfd):
    names = [tmp_path / name for name in ("a.messages", "b.mcap", "c.pcap")]
    piped(capture, names[0], "messages", codec="predictive")
    piped(names[0], names[1], "recording")
    piped(names[0], names[2], "pcap")
    said = capfd.readouterr().err
    assert json.loads(said[: said.index("}") + 1])["format"] == "messages", "the summary is no part of the output"
    with names[1].open("rb") as file:
        assert [data for _, data in RecordingReader(file).messages()] == messages_in(names[0])
    assert payloads_in(names[2]) == payloads_in(names[1]) == [packet.payload for packet in PACKETS]


def test_a_recording_is_passed_on_as_it_is_or_coded_again(tmp_path, recording):
    piped(None, tmp_path / "as", "messages", spec=str(recording))
    with recording.open("rb") as file:
        sent = [data for _, data in RecordingReader(file).messages()]
    assert messages_in(tmp_path / "as") == sent
    piped(None, tmp_path / "two", "messages", spec=str(recording), codec="zstd", frames=2)
    assert [wire.peek(data).codec for data in messages_in(tmp_path / "two")] == [2, 2]


@pytest.mark.parametrize(("query", "codec"), [("", None), ("", "raw"), ("?read=messages", None)])
def test_a_recording_keeps_the_names_of_its_source(tmp_path, recording, query, codec):
    piped(None, tmp_path / "out", "recording", spec=f"{recording}{query}", codec=codec, frames=1)
    with (tmp_path / "out").open("rb") as file:
        metadata = RecordingReader(file).metadata
    assert (metadata["vehicle"], metadata["sensor"]) == ("car-7", "roof")


def test_frames_that_have_no_points_are_reported(tmp_path, capture, caplog):
    with pytest.raises(SourceError, match="has no frame that can be passed on"):
        piped(capture, tmp_path / "out", "points", model="packets")
    assert (tmp_path / "out").read_bytes() == b""
    assert "no points can be made of packets of unknown sensor" in caplog.text


def test_points_are_those_of_the_frames(tmp_path, recording, capfd):
    piped(None, tmp_path / "points", "points", spec=str(recording))
    said, (data, at) = json.loads(capfd.readouterr().err), ((tmp_path / "points").read_bytes(), 0)
    with open_source(recording) as source:
        frames = list(source.frames())
    assert (said["frames"], said["points"]) == (len(frames), sum(len(frame.cloud()) for frame in frames))
    for frame in frames:
        stamp_ns, count, size = struct.unpack_from("<qII", data, at)
        at += 16
        cloud = frame.cloud()
        assert (stamp_ns, count, size) == (frame.stamp_ns, len(cloud), 16)
        points = np.frombuffer(data, "<f4", 4 * count, at).reshape(count, 4)
        for column, name in enumerate(("x", "y", "z", "intensity")):
            assert np.array_equal(points[:, column], cloud[name].astype("f4"))
        at += size * count
    assert at == len(data)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"", "is empty"),
        (b"\x89MCAP0\r\n" + bytes(99), "give its path"),
        (struct.pack("<I", 2**32 - 1) + b"\x93LDC" + bytes(99), "the limit is"),
        (struct.pack("<I", 200) + b"\x93LDC" + bytes(99), "ends within a message"),
        (struct.pack("<I", 60) + b"\x93LDC" + bytes(56) + b"\1", "ends within a message"),
        (struct.pack("<I", 60) + b"\x93LDC" + bytes(56), "has no frame"),
        (b"GET / HTTP/1.1\r\n", "not a pcap or pcapng file"),
        (b"\xd4\xc3\xb2\xa1" + bytes(40), "holds no sensor packets"),
    ],
)
def test_what_is_no_input_is_reported(tmp_path, data, said):
    (tmp_path / "in").write_bytes(data)
    with pytest.raises(SourceError, match=said):
        piped(tmp_path / "in", tmp_path / "out", "messages")


def test_what_waits_in_a_pipe_is_read_after_a_signal_and_no_more_is_waited_for(capture):
    """Though the pipe stays open."""
    data = capture.read_bytes()[:9000]
    read, write = os.pipe()
    os.write(write, data[:3])
    os.write(write, data[3:])
    asked = iter([False] * 3)
    assert io.BufferedReader(inputs.Input(read, lambda: next(asked, True))).read() == data
    os.close(read)
    os.close(write)


@pytest.mark.parametrize("rest", [0, 40])
def test_of_a_message_that_a_signal_cuts_the_rest_is_waited_for(monkeypatch, rest):
    """If it does not come, the input ends before that message, and this is no error."""
    monkeypatch.setattr(inputs, "REST_S", 0.3)
    whole = struct.pack("<I", 60) + b"\x93LDC" + bytes(56)
    read, write = os.pipe()
    os.write(write, whole + whole[:-40])
    asked = iter([False] * 4)
    later = threading.Timer(0.1, os.write, (write, bytes(rest)))
    later.start()
    found = list(inputs.messages(inputs.Input(read, lambda: next(asked, True))))
    later.join()
    assert found == [whole[4:]] * (2 if rest else 1)
    os.close(read)
    os.close(write)


def test_messages_that_come_with_a_signal_are_passed_on(tmp_path, recording):
    """The second one is half there when the signal comes. The pipe stays open, and nothing is wrong."""
    piped(None, tmp_path / "in", "messages", spec=str(recording))
    data, (first, second) = (tmp_path / "in").read_bytes(), messages_in(tmp_path / "in")[:2]
    both, out = len(first) + len(second) + 8, tmp_path / "out"
    read, write = os.pipe()

    def give() -> None:
        with open(write, "wb", closefd=False) as file:
            file.write(data[: both - 9])
            file.flush()
            eventually(lambda: out.stat().st_size > 0, 60.0)
            os.kill(os.getpid(), signal.SIGINT)
            file.write(data[both - 9 : both])

    with out.open("wb") as file:
        thread = threading.Thread(target=give)
        thread.start()
        run("-", "messages", None, [], None, None, None, as_json=False, standard=(read, file.fileno()))
    thread.join()
    os.close(read)
    os.close(write)
    assert messages_in(out) == [first, second]


@pytest.mark.parametrize("form", ["messages", "recording", "pcap"])
def test_whole_frames_before_a_cut_message_are_passed_on(tmp_path, recording, form):
    """Of a codec that holds frames back, too; `recording` and `pcap` are then whole."""
    piped(None, tmp_path / "whole", "messages", spec=str(recording))
    (tmp_path / "cut").write_bytes((tmp_path / "whole").read_bytes()[:-100])
    codec = None if form == "pcap" else "jpeg-layered"
    with pytest.raises(SourceError, match="ends within a message; 3 frames before that were passed on"):
        piped(tmp_path / "cut", tmp_path / "out", form, codec=codec)
    if form == "messages":
        assert [wire.unpack(data).frame_count for data in messages_in(tmp_path / "out")] == [3]
    else:
        with open_source(tmp_path / "out") as source:
            assert len(list(source.packets())) > 0
            assert not source.counts["truncated"]


@pytest.mark.parametrize("form", ["messages", "recording", "pcap"])
def test_a_damaged_message_is_no_success(tmp_path, recording, form):
    """All others are passed on. The exit code was 0, so `pipe ... && rm` lost the frame for good."""
    hurt = damaged_message(recording, tmp_path / "hurt.mcap", 1)
    with pytest.raises(
        SourceError, match=r"[1-3] messages or frames could not be passed on; [1-3] frames were passed on"
    ):
        piped(None, tmp_path / "out", form, spec=str(hurt))
    assert (tmp_path / "out").stat().st_size > 0


@pytest.mark.parametrize("form", ["messages", "recording", "pcap"])
def test_a_recording_of_which_a_part_is_gone_is_no_success(tmp_path, recording, form):
    data = bytearray(recording.read_bytes())
    data[len(data) // 2] ^= 0xFF
    (tmp_path / "hurt.mcap").write_bytes(data)
    with pytest.raises(SourceError, match=r"input is damaged, .*; [1-3] frames were passed on"):
        piped(None, tmp_path / "out", form, spec=str(tmp_path / "hurt.mcap"))


def test_a_capture_that_is_damaged_is_no_success(tmp_path, capture):
    """As two of them are, one behind the other. The frames of the first were passed on, and the exit code was 0."""
    (tmp_path / "two.pcap").write_bytes(capture.read_bytes() * 2)
    with pytest.raises(SourceError, match="input is damaged"):
        piped(tmp_path / "two.pcap", tmp_path / "out", "pcap")


def test_frames_are_counted_where_messages_are_passed_on(tmp_path, recording):
    """As they are only whole ones can be: that the number ends within one is said, behind those before it."""
    group = tmp_path / "group"
    piped(None, group, "messages", spec=str(recording), codec="jpeg-layered")
    (tmp_path / "two").write_bytes(group.read_bytes() * 2)
    with pytest.raises(
        SettingsError, match=r"--frames 6 falls inside a message of 4 frames: give --frames 4 or 8, or --codec"
    ):
        piped(tmp_path / "two", tmp_path / "six.mcap", "recording", frames=6)
    with (tmp_path / "six.mcap").open("rb") as file:
        reader = RecordingReader(file)
        assert [data for _, data in reader.messages()] == messages_in(group)
        assert not reader.counts["cut"]
    with pytest.raises(SettingsError, match="give --frames 4, or --codec"):
        piped(group, tmp_path / "one", "messages", frames=1)
    assert (tmp_path / "one").read_bytes() == b""
    piped(tmp_path / "two", tmp_path / "four", "messages", frames=4)
    assert messages_in(tmp_path / "four") == messages_in(group)


def test_wrong_usage_is_reported_at_once(capture):
    for words, said in (
        (["--to", "las"], "unknown format"),
        (["--to", "points", "--codec", "zstd"], "leave them out for points"),
    ):
        done = run_here("pipe", capture, *words)
        assert (done.returncode, said in done.stderr) == (2, True), done.stderr


def test_options_of_packets_are_refused_for_messages(tmp_path, recording):
    (tmp_path / "in").write_bytes(struct.pack("<I", 60) + b"\x93LDC" + bytes(56))
    for spec, options in (("-", {"model": "vlp16"}), (str(recording), {"calibration": tmp_path / "db.xml"})):
        with pytest.raises(SettingsError, match=f"--{next(iter(options))} is only for packets"):
            piped(tmp_path / "in", tmp_path / "out", "messages", spec=spec, **options)
    assert (tmp_path / "out").read_bytes() == b""


def test_a_closed_standard_output_is_no_success(recording):
    """`pipe ... >&-` wrote all of it to nowhere, with exit code 0."""
    nowhere = os.open(os.devnull, os.O_RDWR)
    with pytest.raises(SettingsError, match="standard output is closed"):
        run(str(recording), "pcap", None, [], None, None, None, as_json=False, standard=(0, nowhere))
    os.close(nowhere)


def test_a_reader_that_goes_away_is_reported(recording):
    read, write = os.pipe()
    os.close(read)
    with pytest.raises(SourceError, match="the reader of standard output went away after 0 frames"):
        run(str(recording), "points", None, [], None, None, None, as_json=False, standard=(0, write))
    os.close(write)


def test_a_signal_ends_a_recording_that_is_whole_though_the_pipe_stays_open(tmp_path, capture):
    read, write = os.pipe()
    out = tmp_path / "out.mcap"

    def give() -> None:
        with open(write, "wb", closefd=False) as file:
            file.write(capture.read_bytes())
        eventually(lambda: out.stat().st_size > 0, 60.0)
        os.kill(os.getpid(), signal.SIGINT)

    with out.open("wb") as file:
        thread = threading.Thread(target=give)
        thread.start()
        run("-", "recording", "zstd", [], None, None, None, as_json=False, standard=(read, file.fileno()))
    thread.join()
    os.close(read)
    os.close(write)
    assert payloads_in(out) == [packet.payload for packet in PACKETS]
