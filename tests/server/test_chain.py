"""What a viewer of coded messages gets can always be decoded, however many it misses."""

from __future__ import annotations

import contextlib
import random

import pytest

from lidarcodec import open_source, read_frames
from lidarcodec.errors import DecodeError
from lidarcodec.pipeline import StreamDecoder, StreamEncoder, frames_of
from lidarcodec.settings import StreamSettings
from lidarcodec.wire import pack, unpack
from lidarcodec_server.live.chain import PENDING, Coded, KeyChain, coded
from tests.sweeps import sampled

HISTORY = StreamSettings(codec="pcodec", codec_settings={"mask_history": True}, key_interval=12)


@pytest.fixture(scope="module")
def frames():
    """Slabs of a twelfth of a turn: 12 times less to code than whole turns."""
    with open_source("sim:road?frames=1") as source:
        return list(frames_of(source.packets(), source.sensor, "packets:29"))


def stream(frames, settings, number, stream_id=1):
    """Messages of a stream that runs over the same frames again and again, by index."""
    encoder = StreamEncoder(settings, stream_id)
    for index in range(number):
        for message in encoder.encode(frames[index % len(frames)].with_(index=index)):
            yield pack(message)


@pytest.mark.parametrize("settings", [StreamSettings(key_interval=9), HISTORY], ids=["intra", "chain"])
@pytest.mark.parametrize("seed", sampled(range(3), [0]))
def test_whatever_a_viewer_misses_it_can_decode_what_it_gets(frames, settings, seed):
    chance = random.Random(seed)
    chain, decoder, got, offered = KeyChain(), StreamDecoder(), 0, 0
    changed = StreamSettings(codec="zstd", key_interval=9)
    parts = [stream(frames, settings, 60), stream(frames, changed, 20, 2), stream(frames, settings, 40, 3)]
    for data in (one for part in parts for one in part):
        offered += 1
        chain.offer(coded(data))
        while chance.random() < 0.5 and (message := chain.take()) is not None:
            assert decoder.decode(unpack(message.data))
            got += 1
    while (message := chain.take()) is not None:
        assert decoder.decode(unpack(message.data))
        got += 1
    assert got + chain.skipped == offered
    assert got > 10


def test_a_viewer_that_keeps_up_misses_nothing(frames):
    chain = KeyChain()
    for data in stream(frames, HISTORY, 30):
        assert chain.offer(coded(data))
        assert chain.take().data == data
    assert chain.skipped == 0


def message(first, *, key=False, needs=None, codec=1, stream_id=1, calibration=b"c"):
    return Coded(b"", stream_id, codec, key, first, 1, needs, calibration, first)


def test_who_falls_behind_a_chain_waits_for_the_next_key_and_says_so():
    chain = KeyChain()
    assert not chain.offer(message(0))
    assert chain.offer(message(1, key=True))
    assert chain.take().first == 1
    for index in range(2, 2 + PENDING):
        assert chain.offer(message(index, needs=index - 1))
    assert not chain.offer(message(2 + PENDING, needs=1 + PENDING))
    assert chain.lost
    assert chain.take() is None
    assert not chain.offer(message(3 + PENDING, needs=2 + PENDING))
    assert chain.offer(message(20, key=True))
    assert chain.take().first == 20
    assert chain.skipped == 1 + PENDING + 2


def test_a_newer_message_that_stands_alone_takes_the_place_of_older_ones():
    chain = KeyChain()
    chain.offer(message(0, key=True))
    chain.take()
    for index in range(1, 10):
        assert chain.offer(message(index))
    assert chain.take().first == 9
    assert chain.take() is None
    assert chain.skipped == 8


def test_a_key_that_is_needed_is_not_thrown_away_for_what_needs_it():
    chain = KeyChain()
    chain.offer(message(0, key=True))
    for index in range(1, 10):
        chain.offer(message(index))
    assert [chain.take().first, chain.take().first] == [0, 9]


@pytest.mark.parametrize("other", [{"codec": 2}, {"stream_id": 2}, {"calibration": b"d"}])
def test_a_key_of_another_codec_start_or_calibration_opens_nothing(other):
    chain = KeyChain()
    chain.offer(message(0, key=True))
    chain.take()
    assert not chain.offer(message(1, **other))


def test_bytes_that_are_no_message_are_an_error_of_ours():
    whole = next(stream(list(read_frames("sim:road?frames=1")), StreamSettings(codec="raw"), 1))
    assert coded(whole).key
    for cut in range(0, 300):
        with contextlib.suppress(DecodeError):
            coded(whole[:cut])
