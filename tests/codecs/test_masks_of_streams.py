"""Masks in streams with motion: they are smaller, and a stream that lost one says so and begins again."""

from __future__ import annotations

import numpy as np
import pytest

from lidarcodec.codecs import table
from lidarcodec.codecs.base import Decoder, Encoder
from lidarcodec.errors import DecodeError, MissingReferenceError
from lidarcodec.frame import Frame
from lidarcodec.message import Message, Section, SectionType
from lidarcodec.settings import StreamSettings
from tests.golden.test_golden import slabs, turns


def both(codec: str, **own: object) -> tuple[Encoder, Decoder]:
    settings = StreamSettings(codec=codec, codec_settings=own, max_error_m=0, key_interval=100)
    return table.make_encoder(settings, 1), table.make_decoder(table.codec_id(codec))


def kinds(messages: list[Message]) -> list[int]:
    return [message.section(SectionType.MASK)[0] for message in messages]


def coded(encoder: Encoder, frames: list[Frame]) -> list[Message]:
    return [message for frame in frames for message in encoder.encode(frame)]


@pytest.mark.parametrize("codec", ["predictive", "riddle"])
@pytest.mark.parametrize("cut", [turns, slabs])
def test_only_streams_that_expect_something_have_such_masks(codec, cut):
    for motion, expected in ((True, [6, 7, 7]), (False, [2, 3, 3])):
        found = kinds(coded(both(codec, motion=motion)[0], cut()))[:3]
        assert found[0] == expected[0]
        assert set(found[1:]) <= {expected[1], 2} if not motion else found == expected


def test_a_reduced_frame_leaves_the_memory_of_masks_as_it_is():
    sent = [frame.with_(index=index) for index, frame in enumerate([*turns(), *turns()])]
    sent[2] = sent[2].with_(keep=np.random.default_rng(1).random(sent[2].range.shape) < 0.2)
    encoder, decoder = both("predictive", motion=True)
    for frame in sent:
        (message,) = encoder.encode(frame)
        (came,) = decoder.decode(message)
        np.testing.assert_array_equal(came.valid, frame.valid)
        assert message.has(SectionType.KEEP) == (frame.keep is not None)


def test_motion_may_be_switched_off_and_on():
    sent = [frame.with_(index=index) for index, frame in enumerate([*turns(), *turns()])]
    encoder, decoder = both("predictive", motion=True)
    for frame in sent:
        settings = StreamSettings(
            codec="predictive", codec_settings={"motion": frame.index % 3 != 1}, max_error_m=0, key_interval=100
        )
        encoder.apply(settings)
        for message in encoder.encode(frame):
            np.testing.assert_array_equal(decoder.decode(message)[0].range, frame.range)


def test_a_lost_message_is_noticed_and_a_key_frame_mends_it():
    encoder, decoder = both("predictive", motion=True)
    first, _, third = (encoder.encode(frame)[0] for frame in turns())
    decoder.decode(first)
    with pytest.raises(MissingReferenceError):
        decoder.decode(third)
    again = turns()[2].with_(index=7)
    (key,) = encoder.encode(again, key=True)
    np.testing.assert_array_equal(decoder.decode(key)[0].range, again.range)
    assert kinds([key]) == [6]


@pytest.mark.parametrize("damaged", [SectionType.MASK, SectionType.RANGE, SectionType.MOTION])
def test_a_message_that_fails_halfway_leaves_nothing_behind_and_what_needs_it_is_refused(damaged):
    encoder, decoder = both("predictive", motion=True)
    first, second, third = (encoder.encode(frame)[0] for frame in turns())
    decoder.decode(first)
    cut = [
        Section(one.type, one.data[: len(one.data) // 2] if one.type == damaged else one.data)
        for one in second.sections
    ]
    with pytest.raises(DecodeError):
        decoder.decode(Message(**{**vars_of(second), "sections": tuple(cut)}))
    with pytest.raises(MissingReferenceError):
        decoder.decode(third)
    for message, frame in zip((second, third), turns()[1:], strict=False):
        np.testing.assert_array_equal(decoder.decode(message)[0].range, frame.range)


def vars_of(message: Message) -> dict[str, object]:
    return {name: getattr(message, name) for name in message.__dataclass_fields__}


def test_a_mask_that_goes_on_where_nothing_began_is_damage():
    encoder, decoder = both("predictive", motion=True)
    messages = coded(encoder, turns())
    mask = next(one for one in messages[1].sections if one.type == SectionType.MASK)
    sections = [mask if one.type == SectionType.MASK else one for one in messages[0].sections]
    with pytest.raises(DecodeError, match="earlier"):
        decoder.decode(Message(**{**vars_of(messages[0]), "sections": tuple(sections)}))
