"""What a user of `riddle` with another sensor than an HDL-64E would lose: a false picture after a loss, or the gain."""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from lidarcodec import wire
from lidarcodec.assembly import packets_of
from lidarcodec.errors import DecodeError, MissingReferenceError
from lidarcodec.frame import Frame
from lidarcodec.message import Message, SectionType
from lidarcodec.pipeline import StreamDecoder, StreamEncoder, frames_of
from lidarcodec.planes.frame_before import runs_between
from lidarcodec.settings import settings_from
from tests.codecs.test_other_sensors import FILES, opened
from tests.fuzz.mutations import mutated

CAPTURES = ("vlp16", "xt32m", "OS-1-128_v2.3.0_1024x10_lb_n3")


def stood(capture: str, count: int, seed: int = 1) -> list[Frame]:
    """A sensor that stands: a part of a real turn again and again, with fresh noise in the ranges."""
    sensor, packets = opened(FILES[capture])
    frame = next(iter(frames_of(packets[:24], sensor, "packets:24")))
    rng, found = np.random.default_rng(seed), []
    for index in range(count):
        noise = rng.integers(-1, 2, frame.range.shape)
        moved = np.where(frame.range > 2, frame.range.astype(np.int64) + noise, frame.range).astype(frame.range.dtype)
        found.append(frame.with_(index=index, range=moved))
    return found


def messages_of(frames: Sequence[Frame], **settings: object) -> list[Message]:
    encoder = StreamEncoder(settings_from({"codec": "riddle", **settings}), 7)
    return [wire.unpack(wire.pack(message)) for frame in frames for message in encoder.encode(frame)]


def assert_same(decoded: Frame, frame: Frame) -> None:
    np.testing.assert_array_equal(decoded.range, frame.range)
    np.testing.assert_array_equal(decoded.intensity, frame.intensity)
    for name, plane in frame.planes.items():
        np.testing.assert_array_equal(decoded.planes[name], plane)


@pytest.mark.parametrize("capture", CAPTURES)
def test_frames_need_the_one_before_up_to_the_next_key_message(capture: str) -> None:
    frames = stood(capture, 5)
    messages, decoder = messages_of(frames, key_interval=3), StreamDecoder()
    assert [message.key for message in messages] == [True, False, False, True, False]
    assert [message.needs for message in messages] == [None, 0, 1, None, 3]
    for frame, message in zip(frames, messages, strict=True):
        (decoded,) = decoder.decode(message)
        assert_same(decoded, frame)
        assert [p.payload for p in packets_of(decoded)] == [p.payload for p in packets_of(frame)]


@pytest.mark.parametrize("capture", CAPTURES)
def test_after_a_loss_nothing_is_shown_until_a_key_message(capture: str) -> None:
    frames = stood(capture, 6)
    messages, decoder = messages_of(frames, key_interval=4), StreamDecoder()
    for number in (0, 1):
        assert_same(decoder.decode(messages[number])[0], frames[number])
    with pytest.raises(MissingReferenceError, match="needs frame 2"):
        decoder.decode(messages[3])
    for number in (4, 5):
        assert_same(decoder.decode(messages[number])[0], frames[number])
    with pytest.raises(MissingReferenceError):
        StreamDecoder().decode(messages[5])


def test_a_late_message_is_still_of_use() -> None:
    frames = stood("vlp16", 4)
    messages, decoder = messages_of(frames), StreamDecoder()
    assert_same(decoder.decode(messages[0])[0], frames[0])
    with pytest.raises(MissingReferenceError):
        decoder.decode(messages[2])
    for number in (1, 2, 3):
        assert_same(decoder.decode(messages[number])[0], frames[number])


@pytest.mark.parametrize("capture", CAPTURES[:2])
def test_a_key_message_can_be_asked_for(capture: str) -> None:
    frames = stood(capture, 3)
    encoder = StreamEncoder(settings_from({"codec": "riddle"}), 7)
    messages = [message for number, frame in enumerate(frames) for message in encoder.encode(frame, key=number == 2)]
    assert [message.key for message in messages] == [True, False, True]
    assert_same(StreamDecoder().decode(messages[2])[0], frames[2])


@pytest.mark.parametrize("capture", CAPTURES[:2])
@pytest.mark.parametrize("seed", range(20))
def test_a_damaged_message_shows_no_false_picture_after_it(capture: str, seed: int) -> None:
    rng, frames = random.Random(seed), stood(capture, 4)
    messages, decoder = messages_of(frames, key_interval=3), StreamDecoder()
    decoder.decode(messages[0])
    sections = list(messages[1].sections)
    at = next(i for i, one in enumerate(sections) if one.type == SectionType.PLANES)
    sections[at] = sections[at]._replace(data=mutated(sections[at].data, rng))
    try:
        decoder.decode(replace(messages[1], sections=tuple(sections)))
    except DecodeError:
        with pytest.raises(MissingReferenceError):
            decoder.decode(messages[2])
    assert_same(decoder.decode(messages[3])[0], frames[3])


def test_frames_alone_refer_to_none_and_cost_more() -> None:
    frames = stood("vlp16", 4)
    alone, after = messages_of(frames, codec_settings={"memory": False}), messages_of(frames)
    assert [message.needs for message in alone] == [None] * 4
    decoder = StreamDecoder()
    for number in (0, 1, 3):
        assert_same(decoder.decode(alone[number])[0], frames[number])
    assert len(wire.pack(after[3])) < 0.7 * len(wire.pack(alone[3]))


@pytest.mark.parametrize("capture", CAPTURES)
def test_bounds_and_attributes_may_change_from_frame_to_frame(capture: str) -> None:
    frames, decoder = stood(capture, 6), StreamDecoder()
    encoder = StreamEncoder(settings_from({"codec": "riddle"}), 7)
    for frame, more in zip(
        frames,
        ({}, {"max_error_m": 0.05}, {"intensity": "off"}, {"intensity": "levels=4"}, {"max_error_m": 1}, {}),
        strict=True,
    ):
        encoder.apply(settings_from({"codec": "riddle", **more}))
        (decoded,) = decoder.decode(encoder.encode(frame)[0])
        off = np.abs(decoded.range.astype(np.int64) - frame.range.astype(np.int64))
        assert int(off.max()) * frame.sensor.range_step_m <= more.get("max_error_m", 0)
        np.testing.assert_array_equal(decoded.range > 0, frame.range > 0)


@pytest.mark.parametrize("start", [0, 35_990, 17_000])
def test_columns_are_looked_up_by_their_direction(start: int) -> None:
    rng = np.random.default_rng(3)
    before = ((start + 20 * np.arange(1800) + rng.integers(0, 3, 1800)) % 36_000).astype(np.uint16)
    for turned in (0, 1, 40, 700):
        now = np.roll(before, -turned)[: 1800 - turned]
        runs = runs_between(before, now)
        assert runs is not None
        assert int(runs[:, 0].sum()) == len(now)
        place = np.concatenate([np.arange(first, first + count) for count, first in runs.tolist()]) % 1800
        off = (before[place].astype(int) - now + 18_000) % 36_000 - 18_000
        assert np.abs(off).max() <= 40
        assert len(runs) <= 4
    assert runs_between(before[:100], before[900:1000]) is None
    assert runs_between(before[:0], before) is None
