"""Turns in parts: each part goes on from the one before it. A lost one costs the rest of its turn, and nothing is ever
decoded with what another part taught."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from lidarcodec import wire
from lidarcodec.assembly.turns import TurnJoiner, joined
from lidarcodec.codecs import table
from lidarcodec.codecs.base import Choosing
from lidarcodec.errors import DecodeError, HeaderError, MissingReferenceError, SettingsError, UnsupportedVersionError
from lidarcodec.frame import WHOLE, Frame, Part
from lidarcodec.message import Message
from lidarcodec.settings import StreamSettings
from tests.golden.test_golden import slabs
from tests.sweeps import sampled

PARTS = 4
CODECS: list[tuple[str, dict[str, object]]] = [
    ("pcodec", {}),
    ("pcodec", {"mask_history": True}),
    ("predictive", {}),
    ("predictive", {"motion": True}),
    ("predictive", {"memory": False}),
    ("riddle", {}),
]
GOING_ON = [one for one in CODECS if one[1] != {"memory": False}]
all_codecs = pytest.mark.parametrize("codec", CODECS, ids=str)
going_on = pytest.mark.parametrize("codec", GOING_ON, ids=str)


def parts(turns: int = 2) -> list[Frame]:
    """Turns in four parts of two slabs each."""
    cut = slabs(turns)
    merged = [joined(cut[at : at + 2]) for at in range(0, len(cut), 2)]
    return [
        frame.with_(index=index, part=Part(index % PARTS > 0, index % PARTS < PARTS - 1))
        for index, frame in enumerate(merged)
    ]


def encoder_of(codec: tuple[str, dict[str, object]], **values: object):
    """An encoder."""
    settings = {"key_interval": 100, "framing": f"parts:{PARTS}"} | values
    return table.make_encoder(StreamSettings(codec=codec[0], codec_settings=codec[1], **settings), 7)


def sent(stream: list[Frame], codec: tuple[str, dict[str, object]], **values: object) -> list[Message]:
    """Messages of a stream, as they come out of the network."""
    encoder = encoder_of(codec, **values)
    return [wire.unpack(wire.pack(one)) for frame in stream for one in encoder.encode(frame)]


def decoder_of(codec: tuple[str, dict[str, object]]):
    """A decoder."""
    return table.make_decoder(table.codec_id(codec[0]))


def came(decoder, messages: list[Message]) -> Iterator[Frame | None]:
    """What is decoded; None for what cannot be."""
    for message in messages:
        try:
            (frame,) = decoder.decode(message)
        except DecodeError:
            yield None
        else:
            yield frame


def assert_same(frame: Frame, original: Frame) -> None:
    """All planes and the side information."""
    for name in ("range", "intensity", "azimuth", "fired"):
        np.testing.assert_array_equal(getattr(frame, name), getattr(original, name))
    assert (frame.index, frame.stamp_ns) == (original.index, original.stamp_ns)
    assert frame.blocks is not None
    assert original.blocks is not None
    np.testing.assert_array_equal(frame.blocks.gps_us, original.blocks.gps_us)


@all_codecs
def test_parts_come_back_and_make_their_turns(codec) -> None:
    stream, joiner, turns = parts(3), TurnJoiner(), []
    messages = sent(stream, codec)
    goes_on = codec in GOING_ON
    assert [message.goes_on for message in messages] == [goes_on and frame.part.goes_on for frame in stream]
    for frame, back in zip(stream, came(decoder_of(codec), messages), strict=True):
        assert back is not None
        assert_same(back, frame)
        turns += joiner.add(back)
    if goes_on:
        assert [turn.index for turn in turns] == [0, PARTS, 2 * PARTS]
        for turn, at in zip(turns, range(0, len(stream), PARTS), strict=True):
            assert_same(turn, joined(stream[at : at + PARTS]))


@all_codecs
@pytest.mark.parametrize("bound", [0.01, 0.05])
def test_every_part_keeps_the_bound(codec, bound: float) -> None:
    stream = parts()
    for frame, back in zip(stream, came(decoder_of(codec), sent(stream, codec, max_error_m=bound)), strict=True):
        assert back is not None
        assert np.abs(back.range.astype(int) - frame.range).max() * 0.002 <= bound + 1e-9
        np.testing.assert_array_equal(back.valid, frame.valid)


@going_on
@pytest.mark.parametrize("lost", sampled(range(PARTS, 2 * PARTS), [PARTS + 1]))
def test_a_lost_part_costs_the_rest_of_its_turn_and_no_more(codec, lost: int) -> None:
    """The publisher hears of it before the next turn, and refers to what is there."""
    stream, encoder, decoder = parts(4), encoder_of(codec), decoder_of(codec)
    there: set[int] = set()
    for frame in stream:
        if isinstance(encoder, Choosing) and not frame.part.goes_on:
            encoder.refer_to(set(there) or {0})
        (message,) = encoder.encode(frame)
        if frame.index == lost:
            continue
        (back,) = list(came(decoder, [message]))
        of_lost = frame.index // PARTS == lost // PARTS
        assert (back is None) == (of_lost and frame.index > lost)
        if back is not None:
            assert_same(back, frame)
            there.add(frame.index)


@going_on
def test_parts_again_and_out_of_order_are_refused_or_right(codec) -> None:
    stream = parts(2)
    messages = sent(stream, codec)
    order = [0, 1, 1, 2, 1, 3, 4, 6, 5, 5, 6, 7]
    decoded = list(came(decoder_of(codec), [messages[at] for at in order]))
    for at, back in zip(order, decoded, strict=True):
        if back is not None:
            assert_same(back, stream[at])
    assert decoded[0] is not None
    assert decoded[2] is None


@going_on
def test_a_damaged_part_teaches_nothing(codec) -> None:
    """A part that is refused half-way, and then comes whole, is not decoded with what the half taught."""
    stream = parts(1)
    messages = sent(stream, codec)
    for section in messages[1].sections:
        if len(section.data) < 12:
            continue
        cut = section._replace(data=section.data[:-3] + bytes(3))
        broken = replace(messages[1], sections=tuple(cut if one is section else one for one in messages[1].sections))
        decoder = decoder_of(codec)
        first, half, again, next_ = came(decoder, [messages[0], broken, messages[1], messages[2]])
        assert first is not None
        for back, original in ((again, stream[1]), (next_, stream[2])):
            if back is not None and half is None:
                assert_same(back, original)


@going_on
def test_intensities_may_become_few_and_whole_again_within_a_turn(codec) -> None:
    """Few values neither use nor change what lossless intensities go on from."""
    settings = [
        StreamSettings(codec=codec[0], codec_settings=codec[1], intensity=one) for one in ("lossless", "levels=4")
    ]
    encoder, decoder = encoder_of(codec), decoder_of(codec)
    for number, frame in enumerate(parts(3)):
        few = number in (1, 2, PARTS, 2 * PARTS - 1, 2 * PARTS)
        encoder.apply(settings[few])
        (message,) = encoder.encode(frame)
        back = decoder.decode(message)[0]
        np.testing.assert_array_equal(back.range, frame.range)
        if not few:
            assert_same(back, frame)


@going_on
def test_a_key_message_within_a_turn_begins_anew_and_the_rest_goes_on(codec) -> None:
    stream, encoder = parts(1), encoder_of(codec)
    messages = [encoder.encode(frame, key=frame.index == 2)[0] for frame in stream]
    assert [one.goes_on for one in messages] == [False, True, False, True]
    decoder = decoder_of(codec)
    for frame, message in zip(stream[2:], messages[2:], strict=True):
        assert_same(decoder.decode(message)[0], frame)


@going_on
def test_a_key_message_that_is_due_waits_for_the_next_turn(codec) -> None:
    messages = sent(parts(3), codec, key_interval=1)
    assert [one.index(True) for one in np.array([m.key for m in messages]).reshape(3, PARTS).tolist()] == [0, 0, 0]
    assert sum(message.key for message in messages) == 3


def test_parts_that_go_on_cost_less_than_frames_of_their_own() -> None:
    stream, codec = parts(3), ("pcodec", {})
    on = sum(len(wire.pack(one)) for one in sent(stream, codec))
    alone = sum(len(wire.pack(one)) for one in sent([frame.with_(part=WHOLE) for frame in stream], codec))
    assert on < alone


@pytest.mark.parametrize(
    ("codec", "digest"), [(("pcodec", {}), "ea7083dc63e8aab9"), (("predictive", {}), "ef7bfe1d393d851d")], ids=str
)
def test_the_bytes_of_parts_stay(codec, digest: str) -> None:
    data = b"".join(section.data for message in sent(parts(2), codec) for section in message.sections)
    assert hashlib.sha256(data).hexdigest()[:16] == digest


def test_a_reader_that_does_not_know_parts_refuses_them_and_headers_cannot_lie() -> None:
    message = sent(parts(1), ("pcodec", {}))[1]
    data = wire.pack(message)
    assert wire.goes_on(data)
    assert not wire.goes_on(wire.pack(replace(message, goes_on=False)))
    assert not wire.goes_on(data[:20])
    for wrong in (replace(message, needs=None), replace(message, frame_index=9), replace(message, frame_count=2)):
        with pytest.raises(HeaderError):
            wire.pack(wrong)
    with pytest.raises(MissingReferenceError):
        table.make_decoder(message.codec).decode(message)
    flags = bytearray(data)
    flags[15] |= 4
    with pytest.raises(UnsupportedVersionError):
        wire.peek(bytes(flags))


@pytest.mark.parametrize("codec", ["zstd", "png", "h264", "jpeg", "raw"])
def test_codecs_without_parts_say_so(codec: str) -> None:
    with pytest.raises(SettingsError, match="in parts"):
        table.check(StreamSettings(codec=codec, framing="parts:3"))


@pytest.mark.parametrize(
    "values", [{"target_kbps": 1000.0}, {"base_error_m": 0.05}, {"reduction": "columns:2"}, {"codec": "auto"}]
)
def test_what_does_not_go_with_parts_is_refused(values: dict[str, object]) -> None:
    with pytest.raises(SettingsError):
        StreamSettings().changed(framing="parts:3", **values)


@pytest.mark.parametrize("framing", ["parts", "parts:1", "parts:9", "parts:", "parts:03x"])
def test_numbers_of_parts_have_limits(framing: str) -> None:
    with pytest.raises(SettingsError, match="parts:N"):
        StreamSettings().changed(framing=framing)
