"""What every codec must do. Checks are plain functions of a codec, so that a wrong one can be shown to fail.

`tests/codecs/test_contract.py` runs them over `codecs.table`: a new line there is tested without writing a test.
"""

from __future__ import annotations

import resource
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import product

import numpy as np
import pytest

from lidarcodec import wire
from lidarcodec.codecs import table
from lidarcodec.codecs.base import Decoder, Encoder
from lidarcodec.errors import DecodeError, LidarCodecError, MissingReferenceError
from lidarcodec.frame import Frame
from lidarcodec.message import Message
from lidarcodec.pipeline import StreamEncoder
from lidarcodec.settings import StreamSettings, settings_from
from lidarcodec.side import SideInfo
from lidarcodec.wire.checksum import with_checksum
from tests.contracts import frames
from tests.sweeps import ALL, combined, examples

STREAM = 0x1234_5678_9ABC_DEF0


@dataclass(frozen=True)
class CodecUnderTest:
    """A codec and how to make it; the table's own, or a wrong one."""

    name: str
    encoder: Callable[[StreamSettings], Encoder]
    decoder: Callable[[], Decoder]
    bounded: bool = True
    own: dict[str, object] = field(default_factory=dict)

    def settings(self, **values: object) -> StreamSettings:
        """Settings of this codec; one that keeps no bound is asked for none."""
        if not self.bounded:
            values.pop("max_error_m", None)
        return settings_from({"codec": self.name, "codec_settings": self.own, **values})


def from_table(name: str, **own: object) -> CodecUnderTest:
    """The table's codec of that name, with these settings of its own."""
    return CodecUnderTest(
        name,
        lambda settings: table.make_encoder(settings, STREAM),
        lambda: table.make_decoder(table.codec_id(name)),
        table.codec(name).bounded,
        own,
    )


def send(codec: CodecUnderTest, sent: list[Frame], **values: object) -> tuple[list[Frame], list[bytes]]:
    """Frames through encoder, bytes and decoder; what came out, and the bytes."""
    encoder, decoder = codec.encoder(codec.settings(**values)), codec.decoder()
    messages = [message for frame in sent for message in encoder.encode(frame)] + encoder.flush()
    data = [wire.pack(message) for message in messages]
    came = [frame for one in data for frame in decoder.decode(wire.unpack(one))] + decoder.flush()
    assert len(came) == len(sent)
    return came, data


def assert_side_equal(came: SideInfo | None, sent: SideInfo | None) -> None:
    """The packets' bytes are the same; the host's times of receipt, which are in none, within half a microsecond."""
    assert (came is None) == (sent is None)
    if came is None or sent is None:
        return
    np.testing.assert_array_equal(came.layouts[came.layout], sent.layouts[sent.layout])
    assert np.abs(came.packet_ns - sent.packet_ns).max(initial=0) <= 500
    for name in ("gps_us", "status", "irregular", "second"):
        np.testing.assert_array_equal(getattr(came, name), getattr(sent, name), err_msg=name)
    assert came.positions == sent.positions


def assert_same_but_ranges(came: Frame, sent: Frame) -> None:
    """Everything that no range setting may change."""
    assert (came.index, came.stamp_ns) == (sent.index, sent.stamp_ns)
    np.testing.assert_array_equal(came.range > 0, sent.valid, err_msg="mask")
    np.testing.assert_array_equal(came.azimuth, sent.azimuth, err_msg="azimuth")
    np.testing.assert_array_equal(came.fired, sent.fired, err_msg="fired")
    assert came.sensor.hash == sent.sensor.hash
    assert came.sensor.convention == sent.sensor.convention
    assert came.sensor.range_step_m == sent.sensor.range_step_m
    assert came.sensor.name == sent.sensor.name
    assert_side_equal(came.side, sent.side)
    assert (came.pose is None) == (sent.pose is None)
    if came.pose is not None:
        np.testing.assert_array_equal(came.pose, sent.pose)


def assert_equal(came: Frame, sent: Frame, codec: CodecUnderTest) -> None:
    """The frame came back exactly, but for the ranges of a codec that keeps no bound."""
    assert_same_but_ranges(came, sent)
    if codec.bounded:
        np.testing.assert_array_equal(came.range, np.where(sent.valid, sent.range, 0), err_msg="range")
    np.testing.assert_array_equal(came.intensity, sent.intensity, err_msg="intensity")


def check_lossless(codec: CodecUnderTest) -> None:
    """Every frame comes back exactly, alone and one after the other in one stream."""
    ordinary = frames.ordinary()
    for frame in ordinary.values():
        (came,), _ = send(codec, [frame], max_error_m=0)
        assert_equal(came, frame, codec)
    stream = [frame.with_(index=index) for index, frame in enumerate(ordinary.values())]
    for came, frame in zip(send(codec, stream, max_error_m=0, key_interval=6)[0], stream, strict=True):
        assert_equal(came, frame, codec)


def check_bound(codec: CodecUnderTest) -> None:
    """No range is further off than the bound, from the nearest to the farthest; the mask is exact."""
    ladder = np.arange(1, 64 * 1024 + 1, dtype=np.uint32).clip(max=65535).astype(np.uint16).reshape(64, 1024)
    base = frames.scene(171).with_(side=None)
    width = {name: getattr(base, name)[:, :1024] for name in ("azimuth", "fired", "intensity")}
    bounds_m = (0.002, 0.01, 0.1, 1.0, 20.0)
    every_range = base.with_(range=ladder, **width)
    for bound_m, frame in [*product(bounds_m, [every_range]), *combined(bounds_m, frames.ordinary().values())]:
        (came,), _ = send(codec, [frame], max_error_m=bound_m)
        assert_same_but_ranges(came, frame)
        error = np.abs(came.range.astype(int) - frame.range)[frame.valid]
        assert error.max(initial=0) <= round(bound_m / 0.002), bound_m


def check_reduced(codec: CodecUnderTest) -> None:
    """Dropped returns come back as no return, without intensity; those that were kept as they are."""
    rng = np.random.default_rng(7)
    for base in (frames.scene(6), frames.noise(4), frames.three_to_one(3)):
        for fraction in (0.0, 0.1, 1.0):
            frame = base.with_(keep=rng.random(base.range.shape) < fraction)
            (came,), _ = send(codec, [frame], max_error_m=0)
            assert_same_but_ranges(came, frame)
            if codec.bounded:
                np.testing.assert_array_equal(came.range, np.where(frame.valid, frame.range, 0))
            np.testing.assert_array_equal(came.intensity, np.where(frame.valid, frame.intensity, 0))
            assert came.keep is None


def check_intensity(codec: CodecUnderTest) -> None:
    """`off` gives zeros; `levels` at most so many values, `error` none further off, and both zeros without a return."""
    asked = ("off", "levels=2", "levels=16", "levels=255", "error=1", "error=10", "error=127")
    most = frames.noise(80)
    for intensity, frame in [*product(asked, [most]), *combined(asked, frames.ordinary().values())]:
        (came,), _ = send(codec, [frame], intensity=intensity, max_error_m=0)
        assert not came.intensity[~frame.valid].any()
        given, values = (one.intensity[frame.valid].astype(int) for one in (frame, came))
        kind, _, number = intensity.partition("=")
        if kind == "off":
            assert not values.any()
        elif kind == "error":
            assert np.abs(values - given).max(initial=0) <= int(number)
        else:
            assert len(np.unique(values)) <= int(number)
            assert given.size == 0 or np.square(values - given).mean() <= np.square(given - given.mean()).mean() + 0.25
            if len(np.unique(given)) <= int(number):
                np.testing.assert_array_equal(values, given)


def check_same_bytes(codec: CodecUnderTest) -> None:
    """The same frames give the same bytes in a fresh session."""
    sent = [frames.scene(5, index=index) for index in range(4)] + [frames.noise(3, index=4)]
    for values in ({"max_error_m": 0}, {"intensity": "levels=8"}):
        assert send(codec, sent, **values)[1] == send(codec, sent, **values)[1]


def check_lost_message(codec: CodecUnderTest) -> None:
    """After any loss: the right frame, or MissingReferenceError until the next key frame; never a wrong frame."""
    sent = [frames.scene(3, index=index) for index in range(9)]
    encoder = codec.encoder(codec.settings(max_error_m=0, key_interval=4))
    messages = [message for frame in sent for message in encoder.encode(frame)] + encoder.flush()
    for lost in range(len(messages)):
        decoder = codec.decoder()
        for number, message in enumerate(messages):
            if number == lost:
                continue
            try:
                came = decoder.decode(message)
            except MissingReferenceError:
                key_since = any(other.key for other in messages[lost + 1 : number + 1])
                assert number > lost, "nothing was lost yet"
                assert not key_since, "a key message was there since"
                assert message.needs is not None or messages[lost].key, "it needs no other message"
                continue
            for frame in came:
                assert_equal(frame, sent[frame.index], codec)


def check_index_twice(codec: CodecUnderTest) -> None:
    """Two messages of one index, of which the second is lost: nothing goes on from the first in its place."""
    exact, coarse = (codec.settings(max_error_m=bound, key_interval=100) for bound in (0, 0.1))
    for again, settings in ((frames.scene(9, index=2), exact), (frames.scene(3, index=2), coarse)):
        sent = [frames.scene(3, index=index) for index in (0, 1, 2, 2, 3, 4, 5)]
        sent[3] = again
        encoder, decoder = StreamEncoder(exact, STREAM, lambda settings, _: codec.encoder(settings)), codec.decoder()
        for number, frame in enumerate(sent):
            encoder.apply(settings if number == 3 else exact)
            messages = encoder.encode(frame) + (encoder.flush() if number in (2, 3, 6) else [])
            for message in messages if number != 3 else []:
                try:
                    came = decoder.decode(message)
                except MissingReferenceError:
                    continue
                for one in came:
                    assert_equal(one, sent[one.index + (one.index > 2)], codec)


def check_join(codec: CodecUnderTest) -> None:
    """A decoder joins at a key frame, asked for or regular, and not before."""
    sent = [frames.scene(3, index=index) for index in range(8)]
    encoder = codec.encoder(codec.settings(max_error_m=0, key_interval=100))
    messages = [message for frame in sent for message in encoder.encode(frame, key=frame.index == 5)]
    messages += encoder.flush()
    assert messages[0].key
    decoder = codec.decoder()
    for message in messages[1:]:
        if message.key:
            break
        with pytest.raises(MissingReferenceError):
            decoder.decode(message)
    else:
        pytest.fail("a requested key frame never came")
    late = [message for message in messages if message.frame_index >= 5]
    came = [frame for message in late for frame in decoder.decode(message)] + decoder.flush()
    assert [frame.index for frame in came][-3:] == [5, 6, 7]
    for frame in came:
        assert_equal(frame, sent[frame.index], codec)


def check_key_interval(codec: CodecUnderTest) -> None:
    """Key frames come in time, and `apply` says truly whether the next message is one."""
    settings = codec.settings(max_error_m=0, key_interval=3)
    encoder = codec.encoder(settings)
    for index in range(8):
        told = encoder.apply(settings)
        messages = encoder.encode(frames.scene(1, index=index))
        if messages and messages[0].frame_count == 1:
            assert messages[0].key == told == (index % 3 == 0)


def check_settings_change(codec: CodecUnderTest) -> None:
    """New settings hold from the next frame on, without a gap."""
    encoder, decoder = codec.encoder(codec.settings(max_error_m=0)), codec.decoder()
    changes = [{}, {"intensity": "off"}, {"intensity": "levels=4"}, {"key_interval": 1}, {"intensity": "lossless"}]
    came: list[Frame] = []
    for index, values in enumerate(changes):
        encoder.apply(codec.settings(max_error_m=0, **values))
        for message in encoder.encode(frames.scene(2, index=index)):
            came += decoder.decode(message)
    for message in encoder.flush():
        came += decoder.decode(message)
    assert [bool(frame.intensity.any()) for frame in came] == [True, False, True, True, True]


def check_new_sensor(codec: CodecUnderTest) -> None:
    """A calibration that changes in mid-stream, as when the status bytes have told it, reaches the decoder."""
    sent = [frames.scene(2, index=index) for index in range(4)]
    sent[2:] = [frame.with_(sensor=frames.sensor(9)) for frame in sent[2:]]
    for came, frame in zip(send(codec, sent, max_error_m=0)[0], sent, strict=True):
        assert_equal(came, frame, codec)


def check_contradiction(codec: CodecUnderTest) -> None:
    """A frame with a return that was never fired is refused, not sent without it."""
    frame = frames.three_to_one(2)
    ranges = frame.range.copy()
    ranges[~frame.fired[(frame.sensor.laser_of_ring >= 32).astype(int)]] = 5
    encoder = codec.encoder(codec.settings(max_error_m=0))
    with pytest.raises(LidarCodecError):
        encoder.encode(frame.with_(range=ranges)) or encoder.flush()


def small_messages(codec: CodecUnderTest) -> list[bytes]:
    """Small messages that use every section, a key and a non-key one each."""
    sent = [
        [frames.scene(1, index=0), frames.scene(1, index=1)],
        [frames.irregular_side(3).with_(pose=frames.pose()), frames.three_to_one(1, index=1)],
        [frames.one_return(), frames.scene(1, index=1).with_(keep=np.eye(64, 6) > 0)],
        [frames.noise(1, index=0), frames.scene(1, index=1).with_(side=frames.with_positions(1))],
    ]
    data: list[bytes] = []
    for number, pair in enumerate(sent):
        values = {"intensity": "levels=8"} if number == 2 else {}
        data += send(codec, pair, **values)[1]
    return data


def key_before(codec: CodecUnderTest, data: list[bytes], number: int) -> Decoder:
    """A decoder that has what message `number` needs."""
    decoder = codec.decoder()
    if not wire.peek(data[number]).key:
        decoder.decode(wire.unpack(data[number - 1]))
    return decoder


def resealed(data: bytes | bytearray) -> bytes:
    """The message with its size and checksum made right."""
    body = bytearray(data[:-4])
    body[8:12] = len(data).to_bytes(4, "little")
    return with_checksum(bytes(body))


def check_rotation(codec: CodecUnderTest) -> None:
    """A rotation of a full turn or more is refused where the frame is, not by whoever receives it."""
    frame = frames.scene(2)
    azimuth = frame.azimuth.copy()
    azimuth[:, 3] = 36_000
    with pytest.raises(LidarCodecError, match="turn"):
        codec.encoder(codec.settings()).encode(frame.with_(azimuth=azimuth))


def check_truncated(codec: CodecUnderTest) -> None:
    """Every prefix of a message is refused with an error of ours."""
    for data in small_messages(codec):
        for size in [*range(min(200, len(data))), *range(200, len(data), 37), len(data) - 1]:
            with pytest.raises(DecodeError):
                wire.unpack(data[:size])


def decodes_or_refuses(decoder: Decoder, message: Message) -> None:
    """A frame of the announced size, or an error of ours; nothing else."""
    try:
        came = decoder.decode(message)
    except DecodeError:
        return
    for frame in came:
        assert frame.width == message.width or (frame.width < message.width and message.frame_count > 1)
        assert int(frame.azimuth.max(initial=0)) < 36000


def check_mutated(codec: CodecUnderTest, cases: int = examples(700), seed: int = 8) -> None:
    """Flipped bits and overwritten bytes behind a right checksum: an error of ours or a frame, in bounded memory."""
    rng = np.random.default_rng(seed)
    data = small_messages(codec)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for _ in range(cases):
        number = int(rng.integers(len(data)))
        mutant = bytearray(data[number])
        for _ in range(int(rng.integers(1, 4))):
            at = int(rng.integers(56, len(mutant) - 4)) if rng.random() < 0.9 else int(rng.integers(0, 56))
            mutant[at] = int(rng.integers(256)) if rng.random() < 0.5 else mutant[at] ^ 1 << int(rng.integers(8))
        if rng.random() < 0.15:
            del mutant[int(rng.integers(56, len(mutant) - 4)) : -4]
        try:
            message = wire.unpack(resealed(mutant))
        except DecodeError:
            continue
        decodes_or_refuses(key_before(codec, data, number), message)
    grown_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    assert grown_kib < 200 * 1024, f"{grown_kib} KiB for messages of a few kilobytes"


def check_random_sections(codec: CodecUnderTest) -> None:
    """Sections full of noise, of zeros, empty, missing or twice."""
    rng = np.random.default_rng(9)
    data = small_messages(codec)
    for number, one in enumerate(data):
        whole = wire.unpack(one)
        for at, section in enumerate(whole.sections):
            others = whole.sections[:at] + whole.sections[at + 1 :]
            fillings = [b"", b"\0", bytes(len(section.data)), rng.bytes(len(section.data)), section.data + b"\0"]
            variants = [(*others, section._replace(data=filling)) for filling in fillings]
            every = (*variants, others, (*whole.sections, section))
            for sections in every if ALL else every[(number + at) % 3 :: 3]:
                changed = Message(**(whole.__dict__ | {"sections": sections}))
                decodes_or_refuses(key_before(codec, data, number), changed)


def check_resized(codec: CodecUnderTest) -> None:
    """A header that announces another width or packet count than the sections hold."""
    data = small_messages(codec)
    for number, one in enumerate(data):
        whole = wire.unpack(one)
        for changes in ({"width": 0}, {"width": whole.width + 1}, {"width": 24576}, {"packets": 0}, {"packets": 2048},
                        {"frame_count": 64}, {"codec": 999}):  # fmt: skip
            changed = Message(**(whole.__dict__ | changes))
            decodes_or_refuses(key_before(codec, data, number), changed)


CHECKS: tuple[Callable[[CodecUnderTest], None], ...] = (
    check_lossless,
    check_bound,
    check_reduced,
    check_intensity,
    check_same_bytes,
    check_lost_message,
    check_index_twice,
    check_join,
    check_key_interval,
    check_settings_change,
    check_new_sensor,
    check_contradiction,
    check_rotation,
    check_truncated,
    check_mutated,
    check_random_sections,
    check_resized,
)
