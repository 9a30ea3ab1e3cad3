"""Publisher and subscriber in one process, over the memory transport: what goes in comes out, or is counted."""

from __future__ import annotations

import json
import threading
import time

import pytest

from lidarcodec.apps.publisher import desk
from lidarcodec.apps.publisher.namesakes import Namesake
from lidarcodec.apps.publisher.publisher import Publisher
from lidarcodec.apps.receiver.live_stream import LiveStream, subscribe
from lidarcodec.assembly import packets_of
from lidarcodec.errors import LidarCodecError, TransportError
from lidarcodec.settings import StreamSettings
from lidarcodec.transport import Endpoints
from lidarcodec.transport.base import Priority
from lidarcodec.transport.keys import StreamKeys
from tests.apps.in_memory import KEY, live, publisher
from tests.apps.streams import Loop
from tests.transport.conftest import free_port
from tests.transport.test_contract import eventually

KEYS = StreamKeys()


@pytest.mark.parametrize(
    "settings",
    [
        StreamSettings(),
        StreamSettings(codec="zstd"),
        StreamSettings(codec="raw", framing="packets:29"),
        StreamSettings(framing="revolution"),
    ],
    ids=lambda settings: f"{settings.codec} {settings.framing}",
)
def test_every_packet_of_a_recording_arrives_byte_for_byte(network, settings):
    with live(network, newest=False, until_end=True) as stream:
        with publisher(network, 6, settings, rate="max"):
            got = [packet.payload for frame in stream for packet in packets_of(frame)]
        assert got == Loop(6).payloads()
        counts = stream.summary()
        assert (counts.get("gaps", 0), counts["errors"], counts["replaced"]) == (0, {}, 0)


def test_a_late_subscriber_begins_with_a_key_frame_at_once(network):
    with publisher(network, rate=20.0, settings=StreamSettings(key_interval=10_000)) as car:
        with live(network) as first:
            for _ in range(5):
                assert first.next(60)
            start = time.monotonic()
            with live(network) as late:
                assert late.next(60)
                assert time.monotonic() - start < 60  # the next key frame by itself would come in eight minutes
                assert late.summary()["errors"] == {}
        assert car.status()["key_frames"] >= 2


@pytest.mark.sweep
def test_requests_for_key_frames_are_merged(network):
    with publisher(network, rate=60.0, settings=StreamSettings(key_interval=10_000)) as car, live(network) as stream:
        assert stream.next(60)
        end = network.end()
        time.sleep(0.6)
        before, begin = car.status()["key_frames"], time.monotonic()
        for _ in range(40):
            assert "first_frame" in json.loads(end.ask(KEYS.control_keyframe))
            time.sleep(0.02)
        assert 1 <= car.status()["key_frames"] - before <= 2 + (time.monotonic() - begin) / 0.5


def test_a_target_is_kept_and_the_status_says_what_is_in_reach(network):
    with publisher(network, rate=20.0, settings=StreamSettings(intensity="off", target_kbps=1000)) as car:
        with live(network) as stream:
            for _ in range(20):
                assert stream.next(60)
        rate = car.status()["rate"]
        assert rate["target_kbps"] == 1000
        low, high = rate["reachable_kbps"]
        assert 0 < low < 1000 < high
        assert rate["kbps_5s"] == pytest.approx(1000, rel=0.25)
        assert 0 <= rate["max_error_m"] < 1
        assert car.change(target_kbps=None).settings.target_kbps is None
        assert car.status()["rate"] is None


def test_frames_that_a_target_did_not_carry_are_counted(network):
    everything = StreamSettings(intensity="lossless", reduction="all", target_kbps=100)
    with publisher(network, rate=20.0, settings=everything) as car:
        with live(network) as stream:
            assert stream.next(60)
            assert eventually(lambda: car.status()["left_out"] > 5)
        status = car.status()
        ended = sum(status[name] for name in ("frames", "replaced", "no_receiver", "left_out"))
        assert ended <= status["assembled"]


def test_a_slow_consumer_gets_the_newest_and_both_sides_say_what_was_left_out(network):
    quick = StreamSettings(intensity="off")  # what is slow here is to be the consumer, on any machine
    with publisher(network, settings=quick, rate=60.0) as car, live(network) as stream:
        indices = []
        while len(indices) < 4 or (stream.replaced <= 5 and len(indices) < 40):
            indices.append(stream.next(60).index)
            sent = car.status()["frames"]
            assert eventually(lambda sent=sent: car.status()["frames"] >= sent + 4)
        assert stream.replaced > 5
        assert indices[-1] - indices[0] > 10
        sent = car.status()
        assert sent["frames"] + sent["replaced"] + sent["no_receiver"] + sent["left_out"] <= sent["assembled"]


def test_a_consumer_that_wants_every_frame_slows_the_publisher_down(network):
    """A live source waits for nobody: frames are replaced before they are encoded, and the receiver sees the gaps.

    Such a gap costs no reference, so it must not cost a key frame either, which is dear on a path that is too slow."""
    settings = StreamSettings(key_interval=10_000, codec_settings={"mask_history": True})
    with publisher(network, settings=settings, rate=60.0) as car, live(network, newest=False) as stream:
        assert stream.next(60)
        keys = car.status()["key_frames"]
        for number in range(8):
            assert stream.next(60)
            assert eventually(lambda number=number: car.status()["replaced"] > number)
        assert car.status()["key_frames"] <= keys + 1, "one that was asked for at the beginning may be under way"
        assert stream.replaced == 0
        assert stream.stats.counts["missing"] > 5
        assert stream.summary()["errors"] == {}


def test_the_vehicle_says_what_was_set_over_the_network_and_by_whom(network, caplog, monkeypatch):
    """It had said the settings of its command line, and a server sent others, which an operator had set days ago."""
    monkeypatch.setattr(desk, "TELL_S", 0.0)
    with publisher(network, settings=StreamSettings(codec="zstd")) as car:
        end = network.end()
        asked = json.dumps({"codec": "raw", "target_kbps": None, "by": "anna"}).encode()
        assert json.loads(end.ask(KEYS.control_set, asked))["applied"]["codec"] == "raw"
        assert eventually(lambda: "anna set codec=raw over the network, in place of codec=zstd" in caplog.text)
        assert "DELETE /api/v1/streams/vehicle/lidar/settings" in caplog.text
        end.ask(KEYS.control_reset, b"{}")
        assert eventually(lambda: "somebody gave the command line's settings back" in caplog.text)
        assert car.settings.codec == "zstd"
        for by in ("x" * 65, "\x1b[2J", 7):
            answer = json.loads(end.ask(KEYS.control_set, json.dumps({"codec": "raw", "by": by}).encode()))
            assert answer["field"] == "by", "it is printed on a terminal"


def test_settings_change_between_two_frames(network):
    with publisher(network) as car, live(network, newest=False) as stream:
        assert stream.next(60)
        end = network.end()
        answer = json.loads(end.ask(KEYS.control_set, json.dumps({"codec": "zstd", "max_error_m": None}).encode()))
        assert answer["applied"]["codec"] == "zstd"
        assert answer["key"] is True
        got = [stream.next(60) for _ in range(10)]
        assert got[-1].index > answer["first_frame"]
        assert stream.summary()["errors"] == {}
        assert car.settings.codec == "zstd"
        told = json.loads(end.ask(KEYS.control_get))
        assert told["settings"] == answer["applied"]
        assert told["status"]["frames"] > 0


def test_another_framing_begins_behind_the_current_frame_and_loses_no_packet(network):
    with live(network, newest=False, until_end=True) as stream:
        with publisher(network, 8, rate="max") as car:
            frames, got, applied = iter(stream), [], None
            for frame in frames:
                got.append(frame)
                if len(got) == 2:
                    applied = car.change(framing="packets:100")
        assert [p.payload for frame in got for p in packets_of(frame)] == Loop(8).payloads()
        for frame in got[:-1]:
            assert frame.side.packets == (348 if frame.index < applied.first_frame else 100)


def test_no_frame_before_the_first_has_what_was_changed_with_the_framing(network):
    """Who cut a drive at `first_frame` took a frame with an error of 20 m for a lossless one."""
    settings = StreamSettings(codec="zstd", max_error_m=0.0)
    with live(network, newest=False, until_end=True) as stream:
        with publisher(network, 12, settings=settings, rate=20.0) as car:
            frames, got, applied = iter(stream), [], None
            for frame in frames:
                got.append(frame)
                if len(got) == 3:
                    applied = car.change(framing="packets:200", max_error_m=20.0)
        originals = {packet.payload for packet in Loop(12).packets()}
        for frame in got:
            if frame.index < applied.first_frame:
                assert {packet.payload for packet in packets_of(frame)} <= originals, frame.index


@pytest.mark.parametrize(
    ("query", "field"),
    [
        ({"codec": "mp3"}, "codec"),
        ({"max_error_m": 99}, "max_error_m"),
        ({"nothing": 1}, "nothing"),
        ({"self": 1}, "self"),
        ([], None),
    ],
)
def test_a_change_that_is_not_allowed_is_refused_by_name_and_changes_nothing(network, query, field):
    with publisher(network) as car, live(network) as stream:
        assert stream.next(60)
        answer = json.loads(network.end().ask(KEYS.control_set, json.dumps(query).encode()))
        assert answer["field"] == field
        assert answer["error"]
        assert car.settings == StreamSettings()
        assert stream.next(60)


def test_a_frame_that_cannot_be_encoded_costs_that_frame_only(network, monkeypatch, caplog):
    with publisher(network) as car, live(network) as stream:
        assert stream.next(60)
        encode, left = car._coding.encoder.encode, [3]

        def failing(frame, *, key=False):
            if left[0]:
                left[0] -= 1
                raise LidarCodecError("no such luck")
            return encode(frame, key=key)

        monkeypatch.setattr(car._coding.encoder, "encode", failing)
        assert eventually(lambda: left == [0])
        index = stream.next(60).index
        assert eventually(lambda: (frame := stream.next(60)) is not None and frame.index > index)
        assert car.status()["errors"] == {"encode errors": 3}
    assert sum("no such luck" in record.message for record in caplog.records) == 1


def test_hostile_bytes_on_every_key_are_counted_and_the_stream_goes_on(network):
    with publisher(network) as car, live(network, receiver="office") as stream:
        assert stream.next(60)
        stranger = network.end()
        for key in (KEYS.frame, KEYS.arrived("office"), KEYS.arrived("x"), KEYS.report("office"), KEYS.status):
            sender = stranger.sender(key, Priority.STATUS)
            for data in (b"", b"\x00" * 15, b"\xff" * 500, b"{", b"[]", b"\x93LDC" + bytes(60)):
                sender.put(data)
        for key in (KEYS.control_get, KEYS.control_set, KEYS.control_reset, KEYS.control_keyframe):
            for data in (b"{", b"[1]", b"\xff\xff", b'{"a": ' * 5000, b'{"ping": NaN}', b'{"ping": 1e999}'):
                assert b"error" in stranger.ask(key, data)
        for _ in range(3):
            assert stream.next(60)
        assert car.status()["errors"] == {}
        frames = stranger.sender(KEYS.frame, Priority.FRAMES)  # the ring holds one: a frame may have taken the place
        assert eventually(lambda: frames.put(b"{") or stream.summary()["errors"].get("decode_errors"))


def test_a_subscriber_goes_on_with_a_publisher_that_was_started_again(network):
    with live(network) as stream:
        for _ in range(2):
            with publisher(network) as car:
                assert eventually(
                    lambda car=car: stream.next(60) is not None and stream.stats.stream_id == car.stream_id
                )
            assert eventually(lambda: not stream.alive)
        assert stream.stats.counts["restarts"] == 1


def test_two_publishers_of_one_name_are_told(network, caplog, monkeypatch):
    monkeypatch.setattr("lidarcodec.apps.publisher.publisher.STATUS_S", 0.05)

    def said(what: str) -> int:
        return sum(what in record.message for record in caplog.records)

    with publisher(network), publisher(network), live(network) as stream:
        assert eventually(lambda: stream.next(1) and stream.stats.counts["second_publisher"] > 1)
        assert eventually(lambda: said("another publisher sends as vehicle/lidar, too") == 2), "each in its terminal"
    assert said("two publishers") == 1
    assert said("another publisher") == 2


def test_who_writes_a_name_wrong_is_told_those_that_there_are(network):
    with publisher(network), LiveStream("vehicle/lidr", transport=network.transport()) as stream:
        assert eventually(lambda: stream.others() == ["vehicle/lidar"])


def test_a_publisher_that_follows_another_one_does_not_warn_of_it():
    namesake = Namesake(KEYS, stream_id=1)
    statuses = (
        {"stream_id": "0" * 16, "ended": True},
        {"stream_id": f"{1:016x}"},
        {"stream_id": "a"},
        {"stream_id": 5},
    )
    for status in (*statuses, {"stream_id": "b"}, {"stream_id": "a"}, *statuses[:2] * 3):
        namesake.told(json.dumps(status).encode())
    namesake.told(b"{")
    assert not namesake.found


def test_a_fault_in_a_decoder_costs_that_message_only(network, monkeypatch, caplog):
    with publisher(network), live(network) as stream:
        assert stream.next(60)
        monkeypatch.setattr(stream._receiver._decoder, "decode", lambda message: 1 / 0)
        assert eventually(lambda: stream.summary()["errors"] == {"decode_errors": 1})
        assert stream.next(60)
        assert stream.next(60)
    assert "could not be decoded" in caplog.text


def test_a_vehicle_without_a_network_records_and_ends_when_told(tmp_path):
    endpoints = Endpoints.of(connect=f"tcp/127.0.0.1:{free_port()}")
    with Publisher(Loop(), rate=40.0, endpoints=endpoints, record=tmp_path) as car:
        assert eventually(lambda: car.status()["recording"]["counts"].get("messages", 0) > 5)
        start = time.monotonic()
    assert time.monotonic() - start < 10
    with subscribe(KEY, connect=endpoints.connect[0]) as stream:
        assert stream.next(0.1) is None
        start = time.monotonic()
    assert time.monotonic() - start < 10


@pytest.mark.parametrize(
    "make", [lambda where: Publisher(Loop(), endpoints=where), lambda where: LiveStream(KEY, endpoints=where)]
)
def test_endpoints_that_cannot_be_used_are_reported_at_the_start(make):
    before = set(threading.enumerate())
    with pytest.raises(TransportError):
        make(Endpoints.of(listen="tcp/192.0.2.1:7447")).__enter__()
    assert eventually(lambda: set(threading.enumerate()) <= before)


def test_nobody_receives_so_nothing_is_encoded_and_it_says_so(network):
    with publisher(network, rate=60.0) as car:
        assert eventually(lambda: car.status()["no_receiver"] > 5)
        assert car.status()["encode_ms"]["count"] == 0
        with live(network) as stream:
            assert stream.next(60)


def test_frames_beyond_an_age_are_not_given_out(network):
    with publisher(network), live(network, max_age_s=0.0) as stream:
        assert eventually(lambda: stream.stats.counts["stale"] > 3)
        assert stream.next(0.1) is None


def test_latency_is_measured_from_the_last_packet_and_never_from_a_recording(network):
    with publisher(network, rate=20.0), live(network) as stream:
        for _ in range(5):
            assert stream.next(60)
        assert 0 < stream.summary()["latency_ms"]["p50"] < 30_000  # of a recording it would be years
    with live(network, newest=False, until_end=True) as stream:
        with publisher(network, 2, rate="max"):
            assert len(list(stream)) == 2
        assert stream.summary()["latency_ms"]["p50"] is None
        assert stream.stats.counts["clocks_apart"] == 2
