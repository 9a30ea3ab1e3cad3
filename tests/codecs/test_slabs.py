"""`predictive` in slabs: each goes on where the one before ended. A lost one must cost frames, never wrong ones."""

from __future__ import annotations

import hashlib
from dataclasses import replace

import numpy as np
import pytest

from lidarcodec import wire
from lidarcodec.codecs import table
from lidarcodec.entropy import known_columns
from lidarcodec.errors import MissingReferenceError, SectionError
from lidarcodec.frame import Frame
from lidarcodec.message import Message, Section, SectionType
from lidarcodec.motion.history import StreamHistory
from lidarcodec.settings import StreamSettings
from tests.contracts import frames
from tests.golden.test_golden import slabs

MEMORY, ALONE, MOTION = {"memory": True}, {"memory": False}, {"motion": True}


def encoder_of(own: dict[str, object], bound: float = 0.0, key_interval: int = 100):
    """An encoder of `predictive`."""
    settings = StreamSettings(codec="predictive", codec_settings=own, max_error_m=bound, key_interval=key_interval)
    return table.make_encoder(settings, 7)


def sent(stream: list[Frame], own: dict[str, object], bound: float = 0.0) -> list[Message]:
    """Messages of a stream, as they come out of the network."""
    encoder = encoder_of(own, bound)
    return [wire.unpack(wire.pack(one)) for frame in stream for one in encoder.encode(frame)]


def ranges_bytes(messages: list[Message]) -> int:
    """What ranges take."""
    return sum(len(message.section(SectionType.RANGE)) for message in messages)


def columns_before(message: Message) -> int | None:
    """How many columns before it a slab looks at."""
    return known_columns(message.section(SectionType.RANGE)[2:])


@pytest.mark.parametrize("own", [MEMORY, ALONE, MOTION])
@pytest.mark.parametrize("bound", [0.0, 0.05])
def test_slabs_come_back_within_their_bound(own: dict[str, object], bound: float) -> None:
    stream, decoder = slabs(turns=3), table.make_decoder(11)
    for frame, message in zip(stream, sent(stream, own, bound), strict=True):
        (came,) = decoder.decode(message)
        np.testing.assert_array_equal(came.valid, frame.valid)
        worst = np.abs(came.range.astype(int) - frame.range).max()
        assert worst * 0.002 <= bound + 1e-9


def test_slabs_that_go_on_are_smaller_than_slabs_alone() -> None:
    together, alone = sent(slabs(), MEMORY), sent(slabs(), ALONE)
    assert ranges_bytes(together) < 0.95 * ranges_bytes(alone)
    assert {columns_before(message) for message in alone} == {0}
    widths = [columns_before(message) for message in together]
    assert widths[0] == 0
    assert max(widths) == 128


def test_a_motion_is_sent_when_it_changes_and_not_with_every_slab() -> None:
    """18 bytes twelve times a turn would be a tenth of what expecting something saves."""
    stream = slabs(turns=3)
    motions = [message.section(SectionType.MOTION) for message in sent(stream, MOTION)[1:]]
    assert len(motions[0]) == 18
    assert b"" in motions
    first, second = sent(stream[:2], MOTION)
    parts = [part for part in second.sections if part.type != SectionType.MOTION]
    decoder = table.make_decoder(11)
    decoder.decode(first)
    without = replace(second, sections=(*parts, Section(SectionType.MOTION, b"")))
    with pytest.raises(SectionError, match="motion"):
        decoder.decode(without)


@pytest.mark.parametrize("own", [MEMORY, MOTION])
def test_after_a_lost_slab_nothing_is_shown_before_the_next_key(own: dict[str, object]) -> None:
    stream, decoder, encoder = slabs(turns=3), table.make_decoder(11), encoder_of(own, key_interval=12)
    shown = []
    for frame in stream:
        (message,) = encoder.encode(frame)
        if frame.index == 4:
            continue
        try:
            (came,) = decoder.decode(message)
        except MissingReferenceError:
            continue
        np.testing.assert_array_equal(came.range, frame.range)
        shown.append(came.index)
    assert shown == [0, 1, 2, 3, *range(12, len(stream))]


@pytest.mark.parametrize("own", [MEMORY, MOTION])
def test_a_decoder_that_joins_waits_for_a_key(own: dict[str, object]) -> None:
    stream, decoder, encoder = slabs(turns=3), table.make_decoder(11), encoder_of(own)
    messages = [encoder.encode(frame, key=frame.index in (0, 9))[0] for frame in stream]
    for message in messages[5:9]:
        with pytest.raises(MissingReferenceError):
            decoder.decode(message)
    for frame, message in zip(stream[9:], messages[9:], strict=True):
        np.testing.assert_array_equal(decoder.decode(message)[0].range, frame.range)


def test_slabs_left_out_before_encoding_cost_context_and_nothing_else() -> None:
    """A publisher that is too slow leaves frames out: what comes then is not where the last slab ended."""
    kept = [frame for frame in slabs(turns=3) if frame.index % 4 != 2]
    decoder = table.make_decoder(11)
    messages = sent(kept, MOTION)
    for frame, message in zip(kept, messages, strict=True):
        np.testing.assert_array_equal(decoder.decode(message)[0].range, frame.range)
        assert (columns_before(message) == 0) == (frame.index == 0 or frame.index % 4 == 3)


@pytest.mark.parametrize("own", [MEMORY, MOTION])
def test_whole_frames_steps_and_empty_slabs_between(own: dict[str, object]) -> None:
    """Framing and bound change while a stream runs, and a sensor under a bridge may see nothing for a while."""
    stream = slabs(turns=3)
    wide = frames.scene(24, index=12)
    at = (np.arange(wide.width) * 240 % 36000).astype(np.uint16)
    stream[12] = wide.with_(azimuth=np.tile(at, (2, 1)))
    stream[14] = stream[14].with_(range=np.zeros_like(stream[14].range))
    stream[15] = frames.three_to_one(3, index=15)
    encoder, decoder = encoder_of(own), table.make_decoder(11)
    for frame in stream:
        bound = (0.0, 0.05, 0.002)[frame.index // 2 % 3]
        encoder.apply(StreamSettings(codec="predictive", codec_settings=own, max_error_m=bound, key_interval=100))
        (came,) = decoder.decode(encoder.encode(frame)[0])
        assert np.abs(came.range.astype(int) - frame.range).max() * 0.002 <= bound + 1e-9
        np.testing.assert_array_equal(came.valid, frame.valid)
    assert columns_before(encoder.encode(stream[-1].with_(index=99))[0]) is not None


def test_the_bytes_of_whole_frames_change_with_no_change_of_slabs() -> None:
    for own, digest in ((MEMORY, "f5f89e137e0203c4"), (MOTION, "8a25a83eb02f520f")):
        turn = [frames.scene(25, seed=3, index=index) for index in range(2)]
        at = np.tile((np.arange(turn[0].width) * 240 % 36000).astype(np.uint16), (2, 1))
        messages = sent([frame.with_(azimuth=at) for frame in turn], {**own, "effort": 2})
        found = hashlib.sha256(b"".join(message.section(SectionType.RANGE) for message in messages)).hexdigest()[:16]
        assert found == digest


def test_a_stream_that_never_turns_does_not_pile_up_slabs() -> None:
    """Slabs wait to be remembered as the last turn; those of a sensor that stands must not wait for ever."""
    history = StreamHistory()
    slab = frames.scene(10)
    still = np.zeros_like(slab.azimuth)
    for _ in range(200):
        history.remember(slab.range_u16, still, slab.fired, slab.sensor, slab=True)
    assert len(history._waiting) < 20
