"""`jpeg-layered`: frames in groups, each of which stands for itself; what is held back is never lost."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarcodec.codecs import table
from lidarcodec.codecs.base import Encoder
from lidarcodec.errors import LidarCodecError, SectionError, SettingsError
from lidarcodec.frame import Frame
from lidarcodec.message import Message
from lidarcodec.ranges.image.layers import MAX_SAMPLES, Layers, group_fits, layers_of
from lidarcodec.settings import StreamSettings, settings_from
from tests.contracts import frames
from tests.contracts.codec import from_table, send
from tests.sweeps import examples


def stream(**own: object) -> StreamSettings:
    return settings_from({"codec": "jpeg-layered", "codec_settings": own, "key_interval": 100})


def encoder(**own: object) -> Encoder:
    return table.make_encoder(stream(**own), 1)


def turns(count: int, packets: int = 3, **changes: object) -> list[Frame]:
    return [frames.scene(packets, index=index, **changes) for index in range(count)]


def indices(messages: list[Message]) -> list[int]:
    """Index of each frame that the messages bring."""
    decoder = table.make_decoder(table.codec_id("jpeg-layered"))
    return [frame.index for message in messages for frame in decoder.decode(message)]


def test_a_message_comes_when_the_group_is_full_and_the_rest_at_the_end() -> None:
    one = encoder(group=4)
    came = [len(one.encode(frame)) for frame in turns(10)]
    assert came == [0, 0, 0, 1, 0, 0, 0, 1, 0, 0]
    (last,) = one.flush()
    assert (last.frame_index, last.frame_count) == (8, 2)
    assert one.flush() == []


def test_a_lost_group_loses_itself_alone() -> None:
    one = encoder(group=3)
    messages = [message for frame in turns(12) for message in one.encode(frame)] + one.flush()
    assert len(messages) == 4
    for lost in range(1, 4):
        kept = messages[:lost] + messages[lost + 1 :]
        assert indices(kept) == [index for index in range(12) if index // 3 != lost]


def test_a_key_frame_on_demand_begins_a_group() -> None:
    one, sent = encoder(group=8), turns(6)
    messages = [message for frame in sent for message in one.encode(frame, key=frame.index == 4)] + one.flush()
    assert [(message.frame_index, message.frame_count, message.key) for message in messages] == [
        (0, 4, True),
        (4, 2, True),
    ]
    assert indices(messages[1:]) == [4, 5]


def test_another_sensor_ends_a_group() -> None:
    one = encoder(group=8)
    assert one.encode(frames.scene(3, index=0)) == []
    (first,) = one.encode(frames.scene(3, index=1).with_(sensor=frames.sensor(9)))
    (second,) = one.flush()
    assert second.key, "the decoder has not seen this calibration"
    assert indices([first, second]) == [0, 1]
    with pytest.raises(SettingsError):
        one.apply(StreamSettings(codec="jpeg"))


def test_a_quality_that_changes_with_every_frame_leaves_groups_whole() -> None:
    """As a rate control does it: the group in progress takes the last one."""
    one, messages = encoder(group=4, quality=90), []
    for frame in turns(8):
        one.apply(stream(group=4, quality=90 - 10 * (frame.index % 4)))
        messages += one.encode(frame)
    assert [message.frame_count for message in messages] == [4, 4]
    steady = encoder(group=4, quality=60)
    assert [one.sections for frame in turns(4) for one in steady.encode(frame)] == [messages[0].sections]


def test_a_smaller_group_holds_at_once() -> None:
    one = encoder(group=8)
    for frame in turns(5):
        assert one.encode(frame) == []
    one.apply(stream(group=2))
    messages = one.encode(frames.scene(3, index=5)) + one.encode(frames.scene(3, index=6))
    assert [message.frame_count for message in messages] == [5, 2]
    assert indices(messages) == list(range(7))


def test_frames_that_were_replaced_before_encoding_leave_gaps_in_a_group() -> None:
    """Newest wins, before the encoder: a slow path must not make groups of one."""
    one = encoder(group=4)
    messages = [message for frame in turns(12)[::3] for message in one.encode(frame)]
    assert [message.frame_count for message in messages] == [4]
    decoder = table.make_decoder(table.codec_id("jpeg-layered"))
    came = decoder.decode(messages[0])
    assert [(frame.index, frame.stamp_ns) for frame in came] == [(f.index, f.stamp_ns) for f in turns(12)[::3]]


def test_a_frame_that_is_refused_does_not_take_its_group_along() -> None:
    one, bad = encoder(group=4), frames.three_to_one(2, index=1)
    one.encode(frames.scene(2, index=0))
    with pytest.raises(LidarCodecError):
        one.encode(bad.with_(range=np.ones_like(bad.range)))
    one.encode(frames.scene(2, index=2))
    with pytest.raises(LidarCodecError):
        one.encode(bad.with_(range=np.ones_like(bad.range), index=3), key=True)
    assert indices(one.encode(frames.scene(2, index=4)) + one.flush()) == [0, 2, 4]


def test_frames_of_different_widths_share_a_group() -> None:
    sent = [frames.scene(packets, index=index) for index, packets in enumerate((3, 7, 1, 5))]
    sent.append(frames.ordinary()["empty"].with_(index=4))
    sent.append(frames.scene(2, index=5, holes=1.0))
    came, data = send(from_table("jpeg-layered", quality=97), sent)
    assert len(data) == 1
    for frame, other in zip(came, sent, strict=True):
        np.testing.assert_array_equal(frame.range > 0, other.range > 0)
        assert frame.side is None or frame.side.packets == other.side.packets  # type: ignore[union-attr]
        error = np.abs(frame.range.astype(int) - other.range)[other.valid]
        assert error.max(initial=0) < 400


def test_rows_look_in_one_direction_whatever_a_frame_is() -> None:
    """A wall at one azimuth lies in one column, in frames of whole turns, of less and of slabs."""
    columns = np.arange(4 * 2000)
    azimuth = (columns * 18 % 36000).astype(np.uint16)
    place = np.tile((azimuth == 9000).astype(np.uint8), (64, 1))
    for width in (2000, 1900, 500):
        cut = [slice(at, at + width) for at in range(0, 2000 * 4 - width + 1, width)]
        layout = layers_of([azimuth[one] for one in cut])
        image = layout.spread([place[:, one] for one in cut])
        assert np.unique(np.nonzero(image)[1]).size == 1, width
        assert layout.height == 8


@settings(max_examples=examples(60), deadline=None)
@given(seed=st.integers(0, 10**6), count=st.integers(1, 12))
def test_any_group_comes_back_from_its_layers(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    widths = rng.integers(0, 60, count)
    start, step = rng.integers(0, 36000, count), int(rng.integers(0, 4000))
    azimuths = [((s + step * np.arange(w)) % 36000).astype(np.uint16) for s, w in zip(start, widths, strict=True)]
    layout = layers_of(azimuths)
    assert layout.samples <= 64 * 8 * -(-count // 8) * (8192 + 8)
    if not layout.samples:
        assert not widths.any()
        return
    images = [rng.integers(0, 999, (64, w)).astype(np.uint16) for w in widths]
    for came, sent in zip(layout.gather(layout.spread(images)), images, strict=True):
        np.testing.assert_array_equal(came, sent)


@pytest.mark.parametrize(
    ("turn", "starts", "widths"),
    [(0, (0,), (5,)), (10, (5, 0), (3, 3)), (10, (0, 2), (3, 3)), (24577, (0,), (1,)), (24576, (0, 2**31), (1, 1))],
)
def test_a_layout_that_cannot_be_is_refused(turn: int, starts: tuple[int, ...], widths: tuple[int, ...]) -> None:
    with pytest.raises(SectionError):
        Layers(turn, starts, widths)


def test_a_group_never_outgrows_what_a_decoder_takes() -> None:
    assert group_fits(8, 24576)
    assert not group_fits(9, 24576)
    wide = [np.zeros(24576, np.uint16)] * 8
    assert layers_of(wide).samples <= MAX_SAMPLES
