"""A playback is held, and goes on from where somebody wants it: without that, finding a moment means waiting for it."""

from __future__ import annotations

import itertools
import struct
import threading

import httpx
import pytest

from lidarcodec.packet import Packet
from lidarcodec.pipeline import StreamEncoder, frames_of
from lidarcodec.recording import RecordingWriter
from lidarcodec.settings import StreamSettings
from lidarcodec.sources.recording import RecordingSource
from lidarcodec.wire import pack
from lidarcodec_server.live.played_source import PlayedSource
from tests import packets as made
from tests.apps.streams import START_NS, Loop
from tests.server.live import running
from tests.transport.test_contract import eventually

FRAMES = 12
FRAME_NS = 348 * 288_000


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """Twelve frames that need one another, of 0.1 s each."""
    settings = StreamSettings(codec="predictive", key_interval=5)
    path = tmp_path_factory.mktemp("recording") / "drive.mcap"
    encoder = StreamEncoder(settings, stream_id=7)
    with path.open("wb") as file:
        writer = RecordingWriter(file, "car", "lidar", settings)
        for frame in frames_of(list(Loop(FRAMES).packets()), made.sensor(), "packets"):
            for message in encoder.encode(frame):
                writer.write(pack(message))
        writer.close()
    return path


def frame_of(packet: Packet) -> int:
    """Which frame of the recording a packet is of: the sensor's own clock says it."""
    return struct.unpack_from("<I", packet.payload, 1200)[0] // 288 // 348


def test_a_recording_tells_how_long_it_is_and_is_read_from_any_frame(recording):
    source = RecordingSource(recording)
    assert source.span() == (START_NS, START_NS + (FRAMES - 1) * FRAME_NS)
    for start in (0, 3, 7, 11):
        first = next(source.packets(START_NS + start * FRAME_NS))
        assert frame_of(first) == start
    assert list(source.packets(START_NS + FRAMES * FRAME_NS)) == []


def test_a_cut_recording_tells_how_long_what_is_left_of_it_is(recording, tmp_path):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(recording.read_bytes()[:-2000])
    first, last = RecordingSource(cut).span()
    assert first == START_NS
    assert START_NS < last <= START_NS + (FRAMES - 1) * FRAME_NS


def test_what_is_wanted_takes_effect_between_frames_and_a_held_playback_shows_the_place_that_was_looked_for(recording):
    source = PlayedSource(RecordingSource(recording), speed=1000.0)
    packets = source.packets()
    assert {frame_of(packet) for packet in itertools.islice(packets, 400)} == {0, 1}
    source.steer(paused=True, position_s=0.8)
    assert source.position_s == pytest.approx(0.8)
    assert [frame_of(packet) for packet in itertools.islice(packets, 296)] == [1] * 296  # to the end of the frame
    assert [frame_of(packet) for packet in itertools.islice(packets, 348)] == [8] * 348
    waiting = threading.Thread(target=lambda: held.append(frame_of(next(packets))))
    held: list[int] = []
    waiting.start()
    waiting.join(0.3)
    assert held == []
    source.steer(paused=False)
    waiting.join(60)
    assert held == [9]
    source.steer(position_s=99.0)
    assert source.position_s == source.duration_s
    assert {frame_of(packet) for packet in itertools.islice(packets, 347)} == {9}
    assert [frame_of(packet) for packet in packets] == [11] * 348  # and ends
    source.close()


def test_a_held_playback_can_be_ended(recording):
    source = PlayedSource(RecordingSource(recording), speed=1000.0, loop=True)
    packets = source.packets()
    source.steer(paused=True)
    reader = threading.Thread(target=lambda: list(packets))
    reader.start()
    source.close()
    reader.join(60)
    assert not reader.is_alive()


def test_a_loop_begins_again_and_ends_when_it_is_no_loop_any_more(recording):
    source = PlayedSource(RecordingSource(recording), speed=1000.0, loop=True)
    packets = source.packets()
    seen = [frame_of(packet) for packet in itertools.islice(packets, 348 * (FRAMES + 2))]
    assert seen[::348][-3:] == [11, 0, 1]
    source.steer(loop=False)
    assert frame_of(list(packets)[-1]) == 11


def test_a_playback_is_steered_over_the_interface(tmp_path):
    with running(tmp_path) as server, httpx.Client(base_url=server.url, timeout=30) as client:
        with server.publisher():
            assert server.seen()
            path = "/api/v1/streams/vehicle/lidar/recording"
            made_id = client.post(path).json()["id"]
            assert eventually(lambda: (client.get(path).json().get("frames") or 0) >= 8)
            client.delete(path).raise_for_status()
        play = f"/api/v1/recordings/{made_id}/play"
        assert client.patch(play, json={"paused": True}).status_code == 404
        assert client.post(play, json={"rate": 2, "vehicle": "again"}).status_code == 201
        assert server.seen("again/lidar")
        (row,) = (one for one in client.get("/api/v1/fleet").json() if one["vehicle"] == "again")
        assert row["playback"] == made_id
        held = client.patch(play, json={"paused": True, "position_s": 0.2, "rate": 20}).json()
        assert (held["paused"], held["rate"], held["position_s"]) == (True, 20, 0.2)
        assert held["duration_s"] > 0.2

        def there() -> bool:  # on the first frame from there on: on a busy machine some are missing
            playing = client.get(f"/api/v1/recordings/{made_id}").json()["playing"]
            return 0.19 < playing["position_s"] < held["duration_s"]

        assert eventually(there)
        for wrong in ({"position_s": -1}, {"rate": 0}, {"paused": "perhaps"}, {"colour": 1}):
            assert client.patch(play, json=wrong).status_code == 422, wrong
        client.patch(play, json={"paused": False}).raise_for_status()
        assert eventually(lambda: client.get(f"/api/v1/recordings/{made_id}").json()["playing"] is None)
