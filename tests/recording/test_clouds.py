"""Without these a recording made for people opens in their viewer without a picture, or with a wrong one."""

from __future__ import annotations

import io

import numpy as np
import pytest
from mcap.reader import make_reader

from lidarcodec.apps.publisher.publisher import Publisher
from lidarcodec.apps.receiver.live_stream import subscribe
from lidarcodec.apps.recorder import BackgroundRecorder
from lidarcodec.interop.foxglove import POINT_DTYPE
from lidarcodec.pipeline import StreamDecoder, StreamEncoder
from lidarcodec.recording import RecordingReader, RecordingWriter
from lidarcodec.settings import StreamSettings
from lidarcodec.transport.keys import StreamKeys
from lidarcodec.transport.memory import MemoryNetwork
from lidarcodec.wire import pack, unpack
from tests.apps.streams import Loop
from tests.command_line import run_here
from tests.contracts.frames import scene

mcap_protobuf = pytest.importorskip("mcap_protobuf.decoder", reason="read back by mcap-protobuf-support")

POSE = np.eye(4)
POSE[:3, 3] = (10.0, 20.0, 0.5)
SETTINGS = StreamSettings(codec="zstd", max_error_m=0.05, key_interval=3)


def messages(count: int) -> list[bytes]:
    encoder = StreamEncoder(SETTINGS, stream_id=4)
    return [pack(one) for at in range(count) for one in encoder.encode(scene(3, index=at).with_(pose=POSE))]


def decoded(data: list[bytes]):
    decoder = StreamDecoder()
    return [frame for one in data for frame in decoder.decode(unpack(one))]


def recorded(data: list[bytes]) -> bytes:
    file = io.BytesIO()
    with RecordingWriter(file, "car", "roof", SETTINGS, clouds=True) as writer:
        for one, frame in zip(data, decoded(data), strict=True):
            writer.write(one)
            writer.write_cloud(frame)
    return file.getvalue()


def seen(file: bytes) -> dict[str, list]:
    """Messages by topic, as public packages read them."""
    reader = make_reader(io.BytesIO(file), validate_crcs=True, decoder_factories=[mcap_protobuf.DecoderFactory()])
    found: dict[str, list] = {}
    topics = [f"lidarcodec/v1/car/roof/{name}" for name in ("points", "pose")]
    for schema, channel, message, content in reader.iter_decoded_messages(topics=topics):
        assert channel.message_encoding == schema.encoding == "protobuf"
        found.setdefault(channel.topic.rpartition("/")[2], []).append((schema.name, message.log_time, content))
    return found


def check_clouds(found: dict[str, list], frames) -> None:
    for (schema, log_time, cloud), frame in zip(found["points"], frames, strict=True):
        points, wanted = np.frombuffer(cloud.data, POINT_DTYPE), frame.cloud()
        assert (schema, log_time, cloud.frame_id) == ("foxglove.PointCloud", frame.stamp_ns, "car/roof")
        assert cloud.point_stride == 18
        for name in ("x", "y", "z", "intensity", "ring"):
            assert np.array_equal(points[name], wanted[name])
        assert np.array_equal(points["t_ns"].astype("i8") + frame.stamp_ns, wanted["t_ns"])


def test_clouds_and_poses_are_read_by_public_packages_point_for_point() -> None:
    data = messages(5)
    file = recorded(data)
    found = seen(file)
    check_clouds(found, decoded(data))
    for schema, _, pose in found["pose"]:
        assert schema == "foxglove.FrameTransform"
        assert (pose.parent_frame_id, pose.child_frame_id) == ("world", "car/roof")
        assert (pose.translation.x, pose.translation.y, pose.rotation.w) == (10.0, 20.0, 1.0)


def test_the_messages_beside_them_are_what_they_would_be_alone() -> None:
    data = messages(7)
    reader = RecordingReader(io.BytesIO(recorded(data)))
    assert [one for _, one in reader.messages()] == data
    assert [one for _, one in reader.messages(scene(3, index=4).stamp_ns)] == data[3:], "begins at a key message"


def test_a_cut_recording_still_gives_its_messages() -> None:
    data = messages(4)
    file = recorded(data)
    for cut in range(len(file) // 3, len(file), len(file) // 23):
        came = [one for _, one in RecordingReader(io.BytesIO(file[:cut]), warn=False).messages()]
        assert came == data[: len(came)]
        assert came


def test_every_message_and_cloud_is_a_compressed_chunk_of_its_own() -> None:
    file = recorded(messages(4))
    chunks = make_reader(io.BytesIO(file)).get_summary().chunk_indexes
    assert len(chunks) == 4 * 3
    assert {chunk.compression for chunk in chunks} == {"zstd"}


def test_what_is_received_is_recorded_with_its_clouds(tmp_path) -> None:
    data = messages(6)
    recorder = BackgroundRecorder(tmp_path, StreamKeys("car", "roof"))
    recorder.keep_clouds()
    for one, frame in zip(data, decoded(data), strict=True):
        recorder.message(one)
        recorder.cloud(frame)
    recorder.start()
    recorder.close()
    counts = recorder.state()["counts"]
    assert (counts["messages"], counts["clouds"]) == (6, 6)
    (file,) = tmp_path.iterdir()
    check_clouds(seen(file.read_bytes()), decoded(data))
    assert file.stat().st_size <= 6 * (scene(3).points * 18 + 2048) + sum(map(len, data)) + 4096


def test_encode_with_clouds_shows_what_the_messages_decode_to(tmp_path) -> None:
    out = tmp_path / "town.mcap"
    words = ["encode", "sim:city?frames=2", str(out), "--set", "max_error_m=0.2", "--reduction", "voxel"]
    encoded = run_here(*words, "--keep-points", "9000", "--with-clouds")
    assert (encoded.returncode, "with clouds the file has" in encoded.stdout) == (0, True)
    with out.open("rb") as file:
        frames = decoded([data for _, data in RecordingReader(file).messages()])
    reader = make_reader(io.BytesIO(out.read_bytes()), decoder_factories=[mcap_protobuf.DecoderFactory()])
    clouds = [one for *_, one in reader.iter_decoded_messages(topics=["lidarcodec/v1/vehicle/lidar/points"])]
    assert len(clouds) == len(frames) == 2
    for cloud, frame in zip(clouds, frames, strict=True):
        points = np.frombuffer(cloud.data, POINT_DTYPE)
        assert 0 < len(points) < 9500
        assert all(np.array_equal(points[name], frame.cloud()[name]) for name in "xyz")


def test_clouds_need_a_place_to_be_kept() -> None:
    refused = run_here("subscribe", "--with-clouds")
    assert (refused.returncode, "--record DIR" in refused.stderr) == (2, True)


def test_a_live_stream_is_recorded_with_the_clouds_of_its_frames(tmp_path) -> None:
    network = MemoryNetwork()
    with (
        network.transport() as near,
        network.transport() as far,
        subscribe("car/roof", transport=far, newest=False, until_end=True, record=tmp_path, clouds=True) as stream,
        Publisher(Loop(3), transport=near, rate="max", vehicle="car", sensor="roof"),
    ):
        frames = list(stream)
    (file,) = tmp_path.iterdir()
    assert len(frames) == 3
    check_clouds(seen(file.read_bytes()), frames)
