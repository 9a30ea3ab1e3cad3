"""A small file that decodes to hours of work is left, and said; what we write is whole, however little it holds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer

from lidarcodec.budgets import DECODED_BASE, DECODED_PER_BYTE
from lidarcodec.evaluation.coded_recording import CodedRecording
from lidarcodec.evaluation.recorded import RecordedFrames
from lidarcodec.frame import Frame
from lidarcodec.packet import Packet
from lidarcodec.pipeline import StreamEncoder, frames_of
from lidarcodec.recording import MESSAGE_ENCODING, decoding_work
from lidarcodec.sensor_model import SensorModel
from lidarcodec.sensors.clouds.sensor import cloud_sensor
from lidarcodec.settings import StreamSettings
from lidarcodec.sources import open_source
from lidarcodec.wire import pack
from tests import packets as made
from tests.command_line import run_here
from tests.point_clouds import OUSTER, message
from tests.sensors import made_frames as other
from tests.sweeps import sampled

WIDEST, TURN = 24_576, 2088


def frame(index: int, width: int, distance: int) -> Frame:
    """A frame whose returns all have one range; 0: without returns."""
    azimuth = np.broadcast_to((np.arange(width) * 17 % 36_000).astype(np.uint16), (2, width)).copy()
    ranges = np.full((64, width), distance, np.uint16)
    fired = np.ones((2, width), np.bool_)
    return Frame(index, index * 10**8, ranges, np.zeros((64, width), np.uint8), azimuth, fired, made.sensor())


def recording(path: Path, width: int, distance: int, frames: int, codec: str = "predictive") -> Path:
    with path.open("wb") as handle:
        written = CodedRecording(
            handle, StreamEncoder(StreamSettings(codec=codec, max_error_m=0.0)), {"source": "here"}
        )
        for index in range(frames):
            written.write(frame(index, width, distance))
        written.close()
    return path


@pytest.fixture
def bomb(tmp_path: Path) -> Path:
    """One key message of the widest frame, three hundred times in compressed chunks."""
    (coded,) = StreamEncoder(StreamSettings(codec="zstd", max_error_m=0.0)).encode(frame(0, WIDEST, 1000))
    return repeated(pack(coded), 300, tmp_path / "bomb.mcap")


def repeated(data: bytes, times: int, path: Path) -> Path:
    """A message again and again, in compressed chunks."""
    with path.open("wb") as handle:
        writer = Writer(handle, chunk_size=1 << 20, compression=CompressionType.ZSTD)
        writer.start(profile="", library="a stranger")
        channel = writer.register_channel("vehicle/lidar", MESSAGE_ENCODING, schema_id=0)
        for _ in range(times):
            writer.add_message(channel, 0, data, 0, 0)
        writer.finish()
    return path


@pytest.mark.sweep
def test_a_small_file_that_decodes_to_hours_is_left_where_it_is_seen(
    bomb: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    most = DECODED_BASE + DECODED_PER_BYTE * bomb.stat().st_size
    assert bomb.stat().st_size < 10_000
    recorded = RecordedFrames(bomb)
    returns = sum(one.points for one in recorded)
    assert abs(returns - most) < 4e6, "up to the frame that is too much, and columns cost a little, too"
    assert recorded.counts["damaged"] == 1
    with open_source(bomb) as source:
        list(source.packets())
        assert (source.counts["damaged"], source.counts["frames without packets"]) == (1, returns // (64 * WIDEST))
    caplog.clear()
    assert run_here("decode", bomb, tmp_path / "out.npz", "--skip", 30).returncode == 0
    assert "it decodes to more than 2000 returns for each of its bytes; the rest was not read" in caplog.text


@pytest.mark.parametrize(
    ("width", "distance", "frames"),
    sampled([(TURN, 0, 200), (TURN, 1, 30), (WIDEST, 1000, 8), (12, 1000, 99)], [(TURN, 1, 30), (12, 1000, 99)]),
)
def test_what_we_write_is_read_whole_however_little_it_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, width: int, distance: int, frames: int
) -> None:
    """A covered sensor, a wall, the widest wall, and small slabs, without what is allowed to begin with."""
    monkeypatch.setattr(decoding_work, "DECODED_BASE", 0)
    recorded = RecordedFrames(recording(tmp_path / "small.mcap", width, distance, frames))
    assert sum(1 for _ in recorded) == frames
    assert recorded.counts["damaged"] == 0


def dark(sensor: SensorModel, layout: str, packets: int) -> Frame:
    """A frame of another sensor without a return."""
    (given,) = other.made_frames(sensor, layout, packets, 1)
    planes = {name: np.zeros_like(plane) for name, plane in given.planes.items()}
    return given.with_(range=np.zeros_like(given.range), intensity=np.zeros_like(given.intensity), planes=planes)


def dark_cloud(columns: int) -> Frame:
    """A cloud of 16 rows whose points are no returns."""
    data = message(np.zeros(16 * columns, OUSTER), 16)
    (frame,) = frames_of([Packet(data, 0)], cloud_sensor([data]), "packets:1")
    return frame


OS0 = other.ouster("RNG19_RFL8_SIG16_NIR16_DUAL", 16, "OS-0-16")


@pytest.mark.parametrize(
    "given", [dark(OS0, "rng19_rfl8_sig16_nir16_dual", 64), dark_cloud(1000)], ids=["planes", "cloud"]
)
def test_frames_of_other_sensors_without_returns_are_work_too(
    given: Frame, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(decoding_work, "DECODED_BASE", 100_000)
    monkeypatch.setattr(decoding_work, "DECODED_PER_BYTE", 50)
    (coded,) = StreamEncoder(StreamSettings(codec="zstd", max_error_m=0.0)).encode(given)
    recorded = RecordedFrames(repeated(pack(coded), 100, tmp_path / "bomb.mcap"))
    assert 5 < sum(1 for _ in recorded) < 60
    assert recorded.counts["damaged"] == 1


@pytest.mark.parametrize("codec", ["riddle", "raw"])
def test_a_covered_sensor_of_another_model_is_read_whole(
    codec: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(decoding_work, "DECODED_BASE", 0)
    path, given = tmp_path / "small.mcap", dark(OS0, "rng19_rfl8_sig16_nir16_dual", 64)
    with path.open("wb") as handle:
        settings = StreamSettings(codec=codec, max_error_m=0.0)
        written = CodedRecording(handle, StreamEncoder(settings), {"source": "here"})
        for index in range(20):
            written.write(given.with_(index=index, stamp_ns=given.stamp_ns + index * 10**8))
        written.close()
    recorded = RecordedFrames(path)
    assert sum(1 for _ in recorded) == 20
    assert recorded.counts["damaged"] == 0
