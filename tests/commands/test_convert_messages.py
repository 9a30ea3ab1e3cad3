"""Coded messages on their way from a recording to ROS 2 and Foxglove, and back: none may change or get lost."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from lidarcodec import wire
from lidarcodec.interop import ros
from lidarcodec.interop.compressed_cloud import compressed_cloud, message_of
from lidarcodec.pipeline import StreamEncoder, frames_of
from lidarcodec.recording import RecordingReader, RecordingWriter, RosbagWriter
from lidarcodec.settings import StreamSettings
from lidarcodec.sources import open_source
from tests import packets as made
from tests.command_line import run_here
from tests.packets import payloads_in
from tests.sources.test_rosbag import database

TOPIC = "/points/lidarcodec"
POSE = np.array([[0.0, -1.0, 0.0, 3.5], [1.0, 0.0, 0.0, -2.0], [0.0, 0.0, 1.0, 0.25], [0.0, 0.0, 0.0, 1.0]])


def written(path: Path) -> Path:
    """A recording of three frames of `predictive`: the last two need the one before them, and the first has a pose."""
    encoder = StreamEncoder(StreamSettings(codec="predictive"))
    with path.open("wb") as file, RecordingWriter(file, "car-7", "roof") as writer:
        for number, frame in enumerate(frames_of(iter(made.turning(1044)), made.sensor())):
            posed = frame.with_(pose=POSE) if number == 0 else frame
            for message in encoder.encode(posed):
                writer.write(wire.pack(message))
    return path


@pytest.fixture(scope="module")
def recording(tmp_path_factory) -> Path:
    return written(tmp_path_factory.mktemp("recorded") / "drive.mcap")


def messages_in(recording: Path) -> list[bytes]:
    with recording.open("rb") as file:
        return [data for _, data in RecordingReader(file).messages()]


def test_every_message_is_there_byte_for_byte_for_public_packages(tmp_path, recording):
    rosbag2 = pytest.importorskip("rosbags.rosbag2", reason="read back by rosbags (extra `bridges`)")
    from tests.interop.test_compressed_cloud import STORE

    done = run_here("convert", recording, tmp_path / "bag", "--as", "messages")
    assert done.returncode == 0, done.stderr
    sent, stamps = messages_in(recording), []
    with rosbag2.Reader(tmp_path / "bag") as reader:
        assert {one.topic: one.msgtype for one in reader.connections} == {
            TOPIC: ros.COMPRESSED_CLOUD.name,
            "/tf": ros.TF_MESSAGE.name,
        }
        for connection, stamp_ns, data in reader.messages():
            found = STORE.deserialize_cdr(data, connection.msgtype)
            if connection.topic == "/tf":
                assert found.transforms[0].child_frame_id == "car-7/roof"
                continue
            assert found.header.frame_id == "car-7/roof"
            assert found.compressed_data.tobytes() == sent[len(stamps)]
            stamps.append(stamp_ns)
    assert stamps == [wire.peek(data).stamp_ns for data in sent]
    assert len(sent) >= 3


def test_a_bag_of_messages_is_a_source(tmp_path, recording):
    """As a file, as a folder, and in SQLite, which is what Humble records into."""
    for out in (tmp_path / "one.mcap", tmp_path / "bag"):
        assert run_here("convert", recording, out, "--as", "messages").returncode == 0
        assert payloads_in(out) == payloads_in(recording)
    coded = [compressed_cloud(data, 0, "roof") for data in messages_in(recording)]
    path = database(tmp_path / "old.db3", coded, TOPIC)
    with sqlite3.connect(path) as base:
        base.execute("UPDATE topics SET type = ?", (ros.COMPRESSED_CLOUD.name,))
    base.close()
    assert payloads_in(path) == payloads_in(recording)
    back = run_here("convert", tmp_path / "bag", tmp_path / "back.pcap")
    assert back.returncode == 0, back.stderr


def test_messages_of_other_formats_and_lost_ones_are_counted(tmp_path, recording):
    path, sent = tmp_path / "mixed.mcap", messages_in(recording)
    with path.open("wb") as file, RosbagWriter(file, points_topic="/points") as writer:
        for data in (sent[0], sent[2]):  # the second one is lost
            writer.write_coded(data, None)
    with open_source(path) as source:
        found = list(source.packets())
        assert len(found) == len(payloads_in(recording)) * wire.peek(sent[0]).packets // 1044
        assert source.counts["missing references"] == 1
    with path.open("wb") as file, RosbagWriter(file, points_topic="/points") as writer:
        writer.write_coded(sent[0][:56] + bytes(99), None)  # a header, and nothing that it promises
    done = run_here("info", path)
    assert done.returncode == 1
    assert "no message of lidarcodec that can be decoded on topic /points/lidarcodec" in done.stderr


def test_what_does_not_fit_is_said_before_anything_is_written(tmp_path, recording):
    for words, said in (
        ([recording, tmp_path / "out.pcap"], "ends in .mcap, or a folder"),
        ([recording, tmp_path / "out.mcap", "--frames", "1"], "--frames is not for messages"),
        ([recording, tmp_path / "out.mcap", "--topic", "points"], "not a ROS name"),
        *(
            ([recording, tmp_path / "out.mcap", *words], f"{words[0]} is not for messages")
            for words in (
                ("--mount", "1,0,2,0,0,90"),
                ("--poses-of", "vehicle"),
                ("--model", "vlp16"),
                ("--allow-missed",),
                ("--connect", "tcp/localhost:7447"),
                ("--listen", "tcp/localhost:7447"),
                ("--zenoh-config", tmp_path / "zenoh.json5"),
            )
        ),
        ([f"{recording}?read=messages", tmp_path / "out.mcap"], "unknown option of the source"),
        (["sim:city?frames=1", tmp_path / "out.mcap"], "lidarcodec encode"),
        (["sim:city", tmp_path / "out.mcap", "--skip", "1", "--frames", "3"], "OUT.mcap --skip 1 --frames 3`"),
    ):
        done = run_here("convert", *words, "--as", "messages")
        assert (done.returncode, said in done.stderr) == (2, True), done.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_damaged_message_is_left_out_and_said(tmp_path, recording, caplog):
    sent = messages_in(recording)
    damaged = bytearray(sent[1])
    damaged[100] ^= 1
    with (tmp_path / "in.mcap").open("wb") as file, RecordingWriter(file, "car-7", "roof") as writer:
        for data in (sent[0], bytes(damaged)):
            writer.write(data)
    done = run_here("convert", tmp_path / "in.mcap", tmp_path / "out.mcap", "--as", "messages")
    assert done.returncode == 0
    assert "1 damaged messages were left out" in caplog.text
    with (tmp_path / "out.mcap").open("rb") as file:
        coded = [one.data for _, channel, one in make_reader(file).iter_messages() if channel.topic == TOPIC]
    assert [message_of(data) for data in coded] == [sent[0]]
