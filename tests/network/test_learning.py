"""If these fail, a stream that learns cannot be decoded, joined or mended, or a vehicle spends more than it may."""

from __future__ import annotations

import sys
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lidarcodec import wire
from lidarcodec.codecs import table
from lidarcodec.errors import DecodeError, MissingReferenceError, SettingsError
from lidarcodec.frame import Frame
from lidarcodec.message import Message, Section, SectionType
from lidarcodec.network import networks
from lidarcodec.network import update as riddle_update
from lidarcodec.network import weight_file as rf
from lidarcodec.network.learner import WAITING, Learner, Offer
from lidarcodec.network.shelf import native_nets, shipped, weights_of
from lidarcodec.pipeline import StreamDecoder, StreamEncoder
from lidarcodec.settings import StreamSettings
from tests.contracts import frames
from tests.network.test_update import FINENESS, near

STEPS = 60
KEYS = 6
"""A key message every so many, as receivers that come ask for them: what is due by itself costs more than so small
frames save."""
LAST = 28
OFFERS = 20_000


def settings(**own: object) -> StreamSettings:
    return StreamSettings(codec="riddle", max_error_m=0.01, key_interval=1000, intensity="off", codec_settings=own)


@pytest.fixture(scope="module")
def drive() -> list[Frame]:
    """Whole turns of a world that no network was trained on, so that there is much to learn."""
    turn = np.tile((np.arange(150) * 240).astype(np.uint16), (2, 1))
    return [frames.scene(25, seed=3, index=i, azimuth=turn) for i in range(LAST)]


def coded(drive: list[Frame], given: StreamSettings, steps: int = STEPS) -> list[Message]:
    """Messages of a stream that learns after each frame; none of it when steps is 0."""
    encoder = StreamEncoder(given, stream_id=7)
    found = []
    if steps:
        encoder.learn(0)
    for frame in drive:
        found += encoder.encode(frame, key=frame.index % KEYS == 0)
        if steps:
            encoder.learn(steps)
    return [wire.unpack(wire.pack(message)) for message in found]


@pytest.fixture(scope="module")
def stream(drive: list[Frame]) -> list[Message]:
    return coded(drive, settings())


def has_weights(messages: list[Message]) -> list[int]:
    return [message.frame_index for message in messages if message.has(SectionType.WEIGHTS)]


def first_update(messages: list[Message]) -> int:
    """Index of the first message that is no key message and brings weights."""
    return next(m.frame_index for m in messages if m.has(SectionType.WEIGHTS) and not m.key)


def check(came: list[Frame], frame: Frame) -> None:
    (found,) = came
    np.testing.assert_array_equal(found.valid, frame.valid)
    assert np.abs(found.range.astype(int) - frame.range)[frame.valid].max(initial=0) <= 5


def size_of(messages: list[Message]) -> int:
    return sum(len(s.data) for m in messages for s in m.sections if s.type == SectionType.RANGE)


def test_a_stream_that_learns_decodes_and_becomes_smaller(drive: list[Frame], stream: list[Message]) -> None:
    reader = StreamDecoder()
    for message, frame in zip(stream, drive, strict=True):
        check(reader.decode(message), frame)
    begins = first_update(stream)
    assert set(has_weights(stream)) >= {m.frame_index for m in stream[begins:] if m.key}
    assert len(has_weights(stream)) < len(stream) / 2
    plain = coded(drive, settings(), steps=0)
    assert size_of(stream[begins + 4 :]) < 0.99 * size_of(plain[begins + 4 :])


def weights_in(stream: list[Message]) -> list[networks.Weights]:
    """What each WEIGHTS section of a stream gives, in order."""
    known, found = dict(shipped()), []
    for data in (part.data for message in stream for part in message.sections if part.type == SectionType.WEIGHTS):
        if riddle_update.is_update(data):
            found.append(riddle_update.applied(data, known.__getitem__))
        else:
            found.append(rf.unpack_weights(data))
        known[found[-1].name] = found[-1]
    return found


def test_rows_and_scales_learn_what_is_theirs(stream: list[Message]) -> None:
    """Lasers differ, and no training set has this sensor's: without them a stream learns a third less."""
    found = weights_in(stream)
    (cases,) = (net.layers[0].cases.astype(int) for net in found[-1].nets if net.expects)
    rows, scales = cases[: networks.ROW_CASES], cases[networks.ROW_CASES :]
    assert (rows[25:] != rows[:-25]).any()
    assert (scales[1:] != scales[:-1]).any()


@pytest.mark.sweep
def test_the_same_frames_and_calls_give_the_same_bytes(drive: list[Frame], stream: list[Message]) -> None:
    short = first_update(stream) + 2
    assert coded(drive[:short], settings()) == stream[:short]
    plain = coded(drive[:9], settings(), steps=0)
    assert plain == coded(drive[:9], settings(), steps=0)
    assert plain == coded(drive[:9], settings(learn_ms=50), steps=0)  # nobody made the call: nothing was learned


def test_whoever_joins_at_a_key_message_has_the_weights(drive: list[Frame], stream: list[Message]) -> None:
    begins = first_update(stream)
    keys = [m.frame_index for m in stream if m.key and m.frame_index > begins]
    reader = StreamDecoder()
    with pytest.raises(MissingReferenceError):
        reader.decode(stream[begins + 1])
    for message in stream[keys[0] :]:
        check(reader.decode(message), drive[message.frame_index])


@pytest.mark.parametrize(
    "own", [{}, pytest.param({"memory": False}, marks=pytest.mark.sweep)], ids=["with memory", "each frame alone"]
)
def test_a_lost_update_is_asked_for(drive: list[Frame], own: dict[str, object]) -> None:
    """As a live receiver does: a reference that is missing is asked for, and the next key message mends it."""
    encoder, reader = StreamEncoder(settings(**own), stream_id=7), StreamDecoder()
    encoder.learn(0)
    asked, lost, decoded_after = 0, None, 0
    for frame in drive:
        (message,) = encoder.encode(frame, key=asked == 1 and decoded_after == 0)
        encoder.learn(STEPS)
        if message.has(SectionType.WEIGHTS) and lost is None and not message.key:
            lost = frame.index  # on the way
            continue
        try:
            check(reader.decode(wire.unpack(wire.pack(message))), frame)
            decoded_after += lost is not None
        except MissingReferenceError:
            asked += 1
    assert lost is not None
    assert asked == 1
    assert decoded_after == len(drive) - lost - 2


@pytest.mark.sweep
def test_a_file_of_ones_own_goes_on_learning(drive: list[Frame], tmp_path: Path) -> None:
    nets = [weights_of("").net(expects=expects, size=size) for expects in (False, True) for size in (0, 1)]
    (tmp_path / "own.lcrw").write_bytes(rf.pack_weights(nets, {"trained on": "a secret place " * 99}))
    messages = coded(drive, settings(weights=str(tmp_path / "own.lcrw")))
    parts = [[s.data for s in m.sections if s.type == SectionType.WEIGHTS] for m in messages]
    begins = first_update(messages)
    base = rf.unpack_weights(parts[0][0])
    assert len(base.data) < 22_000  # the networks of one effort, and no word of where they come from
    assert [riddle_update.is_update(data) for data in parts[begins]] == [True]
    later = next(m.frame_index for m in messages if m.key and m.frame_index > begins)
    assert [riddle_update.is_update(data) for data in parts[later]] == [False, True]
    for first in (0, later):
        reader = StreamDecoder()
        for message in messages[first:]:
            check(reader.decode(message), drive[message.frame_index])


def test_an_update_needs_what_it_begins_with_and_many_updates_do_not_push_that_out(
    drive: list[Frame], tmp_path: Path
) -> None:
    nets = [weights_of("").net(expects=expects, size=0) for expects in (False, True)]
    (tmp_path / "own.lcrw").write_bytes(rf.pack_weights(nets, {}))
    key = coded(drive[:1], settings(weights=str(tmp_path / "own.lcrw")))[0]
    base = rf.unpack_weights(key.section(SectionType.WEIGHTS))
    others = tuple(section for section in key.sections if section.type != SectionType.WEIGHTS)

    def with_update(seed: int) -> Message:
        update = riddle_update.update_of(base, [near(base.nets[0], seed)], FINENESS)
        return replace(key, sections=(*others, Section(SectionType.WEIGHTS, update.data)))

    with pytest.raises(MissingReferenceError, match=base.name):
        StreamDecoder().decode(with_update(0))
    reader = StreamDecoder()
    check(reader.decode(key), drive[0])
    for seed in range(9):
        check(reader.decode(with_update(seed)), drive[0])


@pytest.mark.sweep
def test_tiles_without_weights_stay_without(drive: list[Frame], tmp_path: Path) -> None:
    """With them a network that was to be quick would take as long as any other after its first update."""

    def cut(net: networks.Net) -> networks.Net:
        first, *others = net.layers
        weights = first.weights.copy()
        weights[:16, 8:40] = 0
        return replace(net, layers=(replace(first, weights=weights), *others))

    nets = [cut(weights_of("").net(expects=expects, size=0)) for expects in (False, True)]
    (tmp_path / "own.lcrw").write_bytes(rf.pack_weights(nets, {}))
    given = weights_in(coded(drive, settings(weights=str(tmp_path / "own.lcrw"))))
    before, after = (weights.net(expects=True, size=0).layers[0].weights for weights in (given[0], given[-1]))
    assert (before != after).any()
    assert not after[:16, 8:40].any()


def test_a_message_with_a_damaged_update_costs_no_more_than_frames(drive: list[Frame], stream: list[Message]) -> None:
    begins = first_update(stream)
    update = stream[begins].section(SectionType.WEIGHTS)
    others = [section for section in stream[begins].sections if section.type != SectionType.WEIGHTS]
    key = next(m.frame_index for m in stream if m.key and m.frame_index > begins)
    rng = np.random.default_rng(4)
    for _ in range(4):
        reader = StreamDecoder()
        for message in stream[begins - begins % KEYS : begins]:
            reader.decode(message)
        broken = bytearray(update)
        broken[int(rng.integers(len(broken)))] ^= 1 << int(rng.integers(8))
        section = Section(SectionType.WEIGHTS, bytes(broken))
        with pytest.raises(DecodeError):
            reader.decode(Message(**{**vars(stream[begins]), "sections": (*others, section)}))
        with pytest.raises(MissingReferenceError):
            reader.decode(stream[begins + 1])
        check(reader.decode(stream[key]), drive[key])


@pytest.mark.sweep
def test_other_settings_begin_with_what_decoders_have(drive: list[Frame]) -> None:
    encoder, reader = StreamEncoder(settings(), stream_id=7), StreamDecoder()
    encoder.learn(0)
    plans = {20: {"effort": 3}, 22: {"effort": 2, "motion": False}, 24: {"effort": 1}, 26: {"learn_ms": 5}}
    for frame in drive:
        if frame.index in plans:
            encoder.apply(settings(**plans[frame.index]))
        for message in encoder.encode(frame):
            check(reader.decode(wire.unpack(wire.pack(message))), frame)
        encoder.learn(STEPS)
    assert encoder.learned is not None


def test_learning_keeps_to_what_it_is_given(drive: list[Frame]) -> None:
    encoder = StreamEncoder(settings(), stream_id=7)
    assert (encoder.learned, encoder.learn(5)) == (None, 0)  # nothing to learn from
    for frame in drive[:4]:
        encoder.encode(frame)
    assert encoder.learn(3) == 3
    assert encoder.learn(0) == 0
    assert encoder.learn(10**9, budget_ms=0) == 0
    assert 0 < encoder.learn(10**9, budget_ms=30) < 10**6  # or it would never have come back
    report = encoder.learned
    assert report is not None
    assert set(report) == {"steps", "samples", "frames_left_out", "updates", "update_bytes", "gain_bits"}
    assert report["samples"] <= sum(frame.points for frame in drive[:4])


def test_frames_that_learning_was_too_slow_for_are_counted(drive: list[Frame]) -> None:
    """Whoever looks why a vehicle gains little from learning could not tell that it had no time."""
    encoder = StreamEncoder(settings(memory=False), stream_id=7)
    encoder.encode(drive[0])
    encoder.learn(0)
    for expected, given in ((4, WAITING + 4), (4, WAITING), (5, WAITING + 1)):
        for frame in drive[:given]:
            encoder.encode(frame)
        assert encoder.learned is not None
        assert encoder.learned["frames_left_out"] == expected
        encoder.learn(0)


def test_there_is_nothing_to_learn_without_a_network(drive: list[Frame]) -> None:
    for given in (settings(effort=1), StreamSettings(codec="predictive"), StreamSettings()):
        encoder = StreamEncoder(given, stream_id=7)
        encoder.encode(drive[0])
        assert (encoder.learn(10), encoder.learned, encoder.learn_ms) == (0, None, 0.0)
    assert StreamEncoder(settings(learn_ms=12.5), stream_id=7).learn_ms == 12.5
    for bad in (-1, 5000, True, "much"):
        with pytest.raises(SettingsError, match="learn_ms"):
            table.check(settings(learn_ms=bad))


def test_weights_are_given_once_and_none_is_lost_between_two_threads() -> None:
    """Lost ones were counted as sent, and the encoder went on without what it had learned until better ones came."""
    weights = weights_of("")
    nets = [weights.net(expects=expects, size=0) for expects in (False, True)]
    learner, offer = Learner(weights, nets, expects=False), Offer(weights, native_nets(nets), None, 1.0)
    given, interval = 0, sys.getswitchinterval()
    thread = threading.Thread(target=lambda: [learner.offer(offer) for _ in range(OFFERS)])
    sys.setswitchinterval(1e-6)
    try:
        thread.start()
        while thread.is_alive():
            given += learner.offered() is not None
    finally:
        sys.setswitchinterval(interval)
    thread.join()
    while learner.offered() is not None:
        given += 1
    assert given == OFFERS
