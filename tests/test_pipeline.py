"""What a user would lose: a stream that goes on while its codec changes, and one that survives a restart."""

from __future__ import annotations

import numpy as np
import pytest

import lidarcodec
from lidarcodec.codecs import table
from lidarcodec.errors import MissingReferenceError, SettingsError, UnknownNameError
from lidarcodec.frame import Frame
from lidarcodec.packet import Packet
from lidarcodec.pipeline import StreamDecoder, StreamEncoder, frames_of
from lidarcodec.settings import StreamSettings, settings_from
from lidarcodec.wire import pack, unpack
from tests.packets import read_plain_pcap, sensor, turning
from tests.sweeps import spread


def packets_after(frames: list[Frame], encoder: StreamEncoder, decoder: StreamDecoder) -> list[Packet]:
    messages = [m for frame in frames for m in encoder.encode(frame)] + encoder.flush()
    decoded = [f for m in messages for f in decoder.decode(unpack(pack(m)))] + decoder.flush()
    return [packet for frame in decoded for packet in lidarcodec.packets_of(frame)]


EXACT = [name for name in table.names() if table.codec(name).bounded]
"""Codecs that are lossless unless told otherwise."""
FRAMINGS = ["packets", "packets:29", "revolution"]


@pytest.mark.parametrize(("codec", "framing"), spread(EXACT, FRAMINGS))
def test_every_codec_gives_the_packets_back(codec: str, framing: str) -> None:
    packets = turning(360, start=35500)
    frames = list(frames_of(packets, sensor(), framing))
    assert packets_after(frames, StreamEncoder(settings_from({"codec": codec})), StreamDecoder()) == packets


@pytest.mark.parametrize(("codec", "framing"), spread([name for name in table.names() if name not in EXACT], FRAMINGS))
def test_a_lossy_codec_gives_all_but_the_ranges_back(codec: str, framing: str) -> None:
    """The same packets at the same times, each return where one was; a client that reads a Velodyne reads them."""
    packets = turning(360, start=35500)
    frames = list(frames_of(packets, sensor(), framing))
    came = packets_after(frames, StreamEncoder(settings_from({"codec": codec})), StreamDecoder())
    assert [packet.stamp_ns for packet in came] == [packet.stamp_ns for packet in packets]
    block = np.dtype([("head", "<u4"), ("returns", [("range", "<u2"), ("intensity", "u1")], 32)])
    for one, other in zip(came, packets, strict=True):
        assert one.payload[1200:] == other.payload[1200:]
        now, then = (np.frombuffer(packet.payload[:1200], block) for packet in (one, other))
        np.testing.assert_array_equal(now["head"], then["head"])
        np.testing.assert_array_equal(now["returns"]["intensity"], then["returns"]["intensity"])
        np.testing.assert_array_equal(now["returns"]["range"] > 0, then["returns"]["range"] > 0)


@pytest.mark.parametrize("codec", EXACT)
@pytest.mark.parametrize("framing", ["packets:100", "revolution"])
def test_every_codec_gives_the_real_capture_back(data_file, codec: str, framing: str) -> None:
    packets = read_plain_pcap(data_file("hdl64e_s3_atwall.pcap"))
    frames = list(frames_of(packets, sensor(), framing))
    assert packets_after(frames, StreamEncoder(settings_from({"codec": codec})), StreamDecoder()) == packets


def test_codec_changes_between_two_frames_without_loss() -> None:
    packets = turning(120)
    encoder, decoder = StreamEncoder(settings_from({"codec": "pcodec"}), stream_id=5), StreamDecoder()
    decoded: list[Frame] = []
    for number, frame in enumerate(frames_of(packets, sensor(), "packets:10")):
        if number % 3 == 2:
            name = EXACT[number % len(EXACT)]
            same = name == encoder.settings.codec
            assert encoder.apply(encoder.settings.changed(codec=name)) or same
        messages = encoder.encode(frame)
        assert all(m.stream_id == 5 for m in messages)
        decoded += [f for m in messages for f in decoder.decode(m)]
    assert [f.index for f in decoded] == list(range(12))
    assert [p for f in decoded for p in lidarcodec.packets_of(f)] == packets


def test_refused_settings_change_nothing() -> None:
    encoder = StreamEncoder(settings_from({"codec": "zstd"}))
    before = encoder.settings
    with pytest.raises(UnknownNameError, match="pcodec"):
        encoder.apply(StreamSettings(codec="mp3"))
    with pytest.raises(SettingsError, match="levle"):
        encoder.apply(StreamSettings(codec="zstd", codec_settings={"levle": 3}))
    assert encoder.settings is before


def test_a_restarted_publisher_is_followed_from_its_key_frame() -> None:
    decoder = StreamDecoder()
    frames = list(frames_of(turning(40), sensor(), "packets:10"))
    first, second = StreamEncoder(stream_id=1), StreamEncoder(stream_id=2)
    for frame in frames[:2]:
        assert decoder.decode(first.encode(frame)[0])
    key, inter = second.encode(frames[2])[0], second.encode(frames[3])[0]
    assert key.key
    assert not inter.key
    with pytest.raises(MissingReferenceError):
        decoder.decode(inter)
    assert decoder.decode(key)
    assert decoder.decode(inter)


def test_a_key_frame_comes_when_asked_for() -> None:
    encoder = StreamEncoder()
    frames = list(frames_of(turning(30), sensor(), "packets:10"))
    assert [encoder.encode(f, key=k)[0].key for f, k in zip(frames, (False, False, True), strict=True)] == [1, 0, 1]


def test_offline_interface_round_trip() -> None:
    frames = list(frames_of(turning(30), sensor(), "packets:10"))
    decoded = list(lidarcodec.decode(lidarcodec.encode(iter(frames), max_error_m=0.01, intensity="off")))
    for frame, back in zip(frames, decoded, strict=True):
        error = frame.range.astype(int) - back.range
        assert abs(error).max() <= 5
        assert not back.intensity.any()
        assert ((frame.range > 0) == (back.range > 0)).all()


def test_offline_interface_refuses_settings_before_it_reads() -> None:
    def untouched():
        raise AssertionError("read before the settings were checked")
        yield

    with pytest.raises(SettingsError, match="max_eror_m"):
        lidarcodec.encode(untouched(), max_eror_m=0.01)
