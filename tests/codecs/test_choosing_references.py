"""Codecs with memory refer to a frame that arrived: what is lost costs itself, and nothing decodes to a wrong frame."""

from __future__ import annotations

import random
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from lidarcodec import wire
from lidarcodec.apps.publisher.references import References
from lidarcodec.codecs import table
from lidarcodec.codecs.kept_frames import KEPT_FRAMES
from lidarcodec.errors import DecodeError, MissingReferenceError
from lidarcodec.frame import Frame
from lidarcodec.message import Message
from lidarcodec.settings import StreamSettings
from tests.contracts import frames
from tests.golden.test_golden import slabs
from tests.sweeps import sampled

CODECS: dict[str, tuple[str, dict[str, Any]]] = {
    "predictive": ("predictive", {}),
    "predictive with motion": ("predictive", {"motion": True}),
    "riddle": ("riddle", {}),
    "riddle without a network": ("riddle", {"effort": 1}),
    "pcodec with mask history": ("pcodec", {"mask_history": True}),
}


def encoder_of(name: str, key_interval: int = 100) -> Any:
    codec, own = CODECS[name]
    return table.make_encoder(StreamSettings(codec=codec, codec_settings=own, key_interval=key_interval), 7)


def decoder_of(name: str) -> Any:
    return table.make_decoder(table.codec_id(CODECS[name][0]))


def through(message: Message) -> Message:
    return wire.unpack(wire.pack(message))


def same(one: Frame, other: Frame) -> bool:
    return bool((one.range == other.range).all() and (one.intensity == other.intensity).all())


@pytest.fixture(scope="module", params=["slabs", "whole frames"])
def stream(request) -> list[Frame]:
    if request.param == "slabs":
        return slabs(3)
    at = np.tile((np.arange(150) * 240 % 36000).astype(np.uint16), (2, 1))
    return [frames.scene(25, seed=3, index=index).with_(azimuth=at) for index in range(20)]


@pytest.mark.parametrize("name", sampled(list(CODECS), ["predictive with motion", "pcodec with mask history"]))
@pytest.mark.parametrize(("loss", "late"), [(0.05, 1), (0.3, 1), (0.2, 3)])
def test_a_lost_message_costs_itself(name, loss, late, stream):
    """late: messages that are sent until a report comes"""
    encoder, decoder, references, chance = encoder_of(name), decoder_of(name), References(), random.Random(5)
    reports: list[list[int]] = []
    for frame in stream:
        while len(reports) >= late:
            references.arrived(reports.pop(0))
        assert encoder.refer_to(references.there())
        (message,) = encoder.encode(frame)
        references.sent(frame.index, message.needs)
        if message.key or chance.random() >= loss:
            (decoded,) = decoder.decode(through(message))
            assert same(decoded, frame)
            reports.append([frame.index])
        else:
            reports.append([])


@pytest.mark.parametrize("name", sampled(list(CODECS), ["predictive with motion", "riddle"]))
def test_where_all_arrives_the_bytes_are_those_of_a_stream_that_is_told_nothing(name, stream):
    told, plain = encoder_of(name, 10), encoder_of(name, 10)
    arrived: set[int] = set()
    for frame in stream[:14]:
        told.refer_to(arrived)
        assert told.encode(frame) == plain.encode(frame)
        arrived.add(frame.index)


def test_another_receiver_goes_on_with_the_next_message_whose_reference_it_has(stream):
    encoder, decoder = encoder_of("predictive with motion"), decoder_of("predictive with motion")
    messages = []
    for frame, there in zip(stream, ({0}, {0}, {0}, {0, 2}, {0, 2}, {0}), strict=False):
        encoder.refer_to(there)
        messages += encoder.encode(frame)
    assert [one.needs for one in messages] == [None, 0, 0, 2, 2, 0]
    assert len(decoder.decode(messages[0])) == 1
    for message in messages[3:5]:  # it missed 1 and 2
        with pytest.raises(MissingReferenceError) as raised:
            decoder.decode(message)
        assert raised.value.needs == 2
    (frame,) = decoder.decode(messages[5])
    assert same(frame, stream[5])
    assert same(decoder.decode(messages[1])[0], stream[1]), "it comes late"


@pytest.mark.parametrize("name", ["predictive", "pcodec with mask history"])
def test_as_many_frames_are_kept_as_the_format_says(name, stream):
    encoder, decoder = encoder_of(name), decoder_of(name)
    for frame in stream[: KEPT_FRAMES + 1]:
        encoder.refer_to({frame.index - 1})
        decoder.decode(encoder.encode(frame)[0])
    encoder.refer_to({1})
    (message,) = encoder.encode(stream[KEPT_FRAMES + 1])
    assert message.needs == 1
    assert same(decoder.decode(message)[0], stream[KEPT_FRAMES + 1])
    encoder.refer_to({2})  # 2 was used longer ago than all that are kept
    (message,) = encoder.encode(stream[KEPT_FRAMES + 2])
    assert message.needs is None
    assert not message.key
    assert same(decoder.decode(message)[0], stream[KEPT_FRAMES + 2])


def test_a_message_that_cannot_be_decoded_leaves_the_others_to_refer_to(stream):
    encoder, decoder = encoder_of("predictive"), decoder_of("predictive")
    encoder.refer_to({0})
    first, second, third = (encoder.encode(frame)[0] for frame in stream[:3])
    decoder.decode(first)
    cut = tuple(one._replace(data=one.data[: len(one.data) // 2]) for one in second.sections)
    with pytest.raises(DecodeError):
        decoder.decode(replace(second, sections=cut))
    assert same(decoder.decode(third)[0], stream[2])
