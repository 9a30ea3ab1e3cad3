"""What a user loses if these fail: his recordings cannot be played, re-coded or turned into captures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lidarcodec.errors import LidarCodecError, SourceError, UnknownNameError
from lidarcodec.evaluation.bench import bench
from lidarcodec.pipeline import StreamEncoder, frames_of
from lidarcodec.recording import RecordingWriter
from lidarcodec.sensors import write_yaml
from lidarcodec.settings import StreamSettings
from lidarcodec.sources import open_source
from lidarcodec.wire import pack
from lidarcodec.wire.header import MAGIC
from tests import packets as made
from tests.sweeps import examples

PACKETS = made.turning(90)


def record(path: Path, what: str = "messages", codec: str = "zstd", sensor=None) -> Path:
    """A recording of PACKETS in frames of 30."""
    settings = StreamSettings(codec=codec, framing="packets:30", key_interval=2)
    encoder = StreamEncoder(settings, stream_id=7)
    with path.open("wb") as file:
        writer = RecordingWriter(file, "car", "lidar", settings)
        for frame in frames_of(PACKETS, sensor or made.sensor(), settings.framing):
            if "messages" in what:
                for message in encoder.encode(frame):
                    writer.write(pack(message))
            if "packets" in what:
                start = frame.index * 30
                writer.write_packets(PACKETS[start : start + 30])
        writer.close()
    return path


@pytest.mark.parametrize("what", ["messages", "packets", "packets and messages"])
def test_a_recording_gives_the_very_packets(tmp_path, what):
    with open_source(record(tmp_path / "drive.mcap", what)) as source:
        assert list(source.packets()) == PACKETS
        assert list(source.packets()) == PACKETS
        assert source.start_ns == PACKETS[0].stamp_ns
        assert not source.counts
        assert source.channel in what
    assert ("raw packets" if "packets" in what else "decoded messages") in source.label


def test_the_sensor_is_that_of_the_messages_unless_another_is_given(tmp_path):
    sensor = made.sensor()
    for what in ("messages", "packets and messages"):
        assert open_source(record(tmp_path / "drive.mcap", what)).sensor.hash == sensor.hash
    assert open_source(record(tmp_path / "drive.mcap", "packets")).sensor.origin == "generic"
    write_yaml(sensor, tmp_path / "given.yaml")
    for what in ("messages", "packets"):
        path = record(tmp_path / "drive.mcap", what)
        assert open_source(path, calibration=tmp_path / "given.yaml").sensor.origin == "given"


def test_what_every_figure_must_say_survives_the_recording(tmp_path):
    sensor = replace(made.sensor(), name="HDL-64E (KITTI odometry, re-gridded)")
    with open_source(record(tmp_path / "drive.mcap", sensor=sensor)) as source:
        assert source.caveat == "KITTI odometry, re-gridded"
    assert bench(tmp_path / "drive.mcap", StreamSettings())["source"].endswith("(KITTI odometry, re-gridded)")


def test_what_to_read_can_be_chosen(tmp_path):
    both = record(tmp_path / "drive.mcap", "packets and messages")
    assert open_source(f"{both}?read=messages").channel == "messages"
    assert open_source(f"{both}?read=packets").channel == "packets"
    with pytest.raises(SourceError, match="no frame that can be decoded and no packets"):
        open_source(f"{record(tmp_path / 'coded.mcap')}?read=packets")
    with pytest.raises(UnknownNameError, match="choose one of packets, messages"):
        open_source(f"{both}?read=clouds")
    with pytest.raises(SourceError, match="no frame"):
        open_source(f"{both}?topic=lidarcodec/v1/car/camera/frame")
    with open_source(f"{both}?topic=lidarcodec/v1/car/lidar/frame") as source:
        assert source.channel == "messages"
        assert list(source.packets()) == PACKETS


@pytest.mark.parametrize("what", ["messages", "packets"])
def test_every_prefix_gives_what_is_whole(tmp_path, what):
    data = record(tmp_path / "drive.mcap", what).read_bytes()
    seen = set()
    for cut in range(0, len(data), len(data) // 60):
        (tmp_path / "cut.mcap").write_bytes(data[:cut])
        try:
            with open_source(tmp_path / "cut.mcap") as source:
                packets = list(source.packets())
        except SourceError:
            seen.add(0)
            continue
        assert packets == PACKETS[: len(packets)]
        assert len(packets) == 90 or source.counts["truncated"] == 1
        seen.add(len(packets))
    assert seen == {0, 30, 60, 90}


@pytest.mark.drawn
@pytest.mark.parametrize("what", ["messages", "packets"])
def test_mutated_recordings_raise_only_our_errors(tmp_path, what):
    data = record(tmp_path / "drive.mcap", what).read_bytes()
    generator = np.random.default_rng(4)
    for _ in range(examples(120)):
        mutated = bytearray(data)
        for _ in range(int(generator.integers(1, 6))):
            mutated[int(generator.integers(8, len(data)))] = int(generator.integers(256))
        (tmp_path / "bad.mcap").write_bytes(mutated)
        try:
            with open_source(tmp_path / "bad.mcap") as source:
                assert all(len(packet.payload) == 1206 for packet in source.packets())
        except LidarCodecError:
            continue


def test_a_damaged_message_is_counted_and_the_next_key_frame_goes_on(tmp_path):
    path = record(tmp_path / "drive.mcap", codec="pcodec")
    data = path.read_bytes()
    first = data.index(MAGIC)
    (tmp_path / "bad.mcap").write_bytes(data[: first + 200] + bytes([data[first + 200] ^ 1]) + data[first + 201 :])
    with open_source(tmp_path / "bad.mcap") as source:
        packets = list(source.packets())
    assert packets == PACKETS[-len(packets) :]
    assert sum(source.counts.values()) >= 1


def test_replay_of_a_recording_is_paced(tmp_path):
    with open_source(record(tmp_path / "drive.mcap"), realtime=True, speed=10.0) as source:
        assert source.live
        assert list(source.packets()) == PACKETS


def test_files_that_are_no_recordings(tmp_path):
    for data in (b"\x89MCAP", b"\x89MCAP0\r\n", b"\x89MCAP0\r\n" + bytes(100)):
        (tmp_path / "no.mcap").write_bytes(data)
        with pytest.raises(SourceError):
            open_source(tmp_path / "no.mcap")
