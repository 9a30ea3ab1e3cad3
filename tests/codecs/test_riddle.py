"""If these fail, a station misreads what a car with another processor or other weights has sent, or falls over it."""

from __future__ import annotations

import os
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from lidarcodec import entropy, wire
from lidarcodec.codecs import table
from lidarcodec.codecs.riddle import RETURNS_PER_BYTE
from lidarcodec.entropy import fast
from lidarcodec.errors import DecodeError, MissingReferenceError, SectionError, SettingsError
from lidarcodec.message import Message, Section, SectionType
from lidarcodec.network import networks
from lidarcodec.network import weight_file as rf
from lidarcodec.network.shelf import native_nets, networks_of, shipped, weights_of
from lidarcodec.settings import StreamSettings
from tests.contracts import frames
from tests.entropy.test_predictive_coder import LEVELS, SENSOR, all_fired, check_bound, guess, mask, scene
from tests.network.test_weights import float_layers, four_nets, with_cases, without_tiles
from tests.sweeps import sampled

STREAM = 7


@pytest.fixture(scope="module")
def own_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A weight file that no package holds."""
    path = tmp_path_factory.mktemp("weights") / "own.lcrw"
    path.write_bytes(rf.pack_weights(four_nets(), {"licence": "CC0"}))
    return path


def settings(**own: object) -> StreamSettings:
    return StreamSettings(codec="riddle", max_error_m=0.01, key_interval=4, codec_settings=own)


def drive(count: int = 6) -> list:
    """Frames of one scene, one after the other."""
    return [frames.scene(20, seed=3 + i, index=i) for i in range(count)]


def messages_of(sent: list, given: StreamSettings) -> list[Message]:
    encoder = table.make_encoder(given, STREAM)
    return [wire.unpack(wire.pack(message)) for frame in sent for message in encoder.encode(frame)]


def decoder():
    return table.make_decoder(table.codec_id("riddle"))


@pytest.mark.parametrize("form", fast.net_forms())
@pytest.mark.parametrize("expects", [False, True])
def test_every_processor_gives_the_odds_of_the_reference(form: str, expects: bool) -> None:
    rng = np.random.default_rng(4)
    inputs = rng.integers(-128, 128, (301, 112 if expects else 72)).astype(np.int8)
    for hidden in ((8, 8), (32, 32), (96, 32), (24, 40), (192, 48), (152, 64), (256, 256)):
        plain = networks.quantised(expects, 0, float_layers(inputs.shape[1], hidden, seed=hidden[0]))
        for net in (plain, with_cases(plain)):
            nets = entropy.NativeNets(form)
            nets.add([layer.given for layer in net.layers])
            np.testing.assert_array_equal(nets.run(inputs), networks.run(net, inputs))


def test_first_layers_of_bytes_give_the_same_on_every_processor() -> None:
    """Their products are those of other instructions, with inputs larger by 128."""
    rng = np.random.default_rng(6)
    for inputs, hidden in ((72, (24, 40)), (112, (192, 48)), (112, (48, 8)), (72, (32, 32)), (112, (152, 64))):
        drawn = float_layers(inputs, hidden, seed=hidden[0])
        first = rng.integers(-128, 128, drawn[0][0].shape)
        first[0], first[1] = -128, 127
        net = networks.quantised(inputs == 112, 2, [(first / 64, drawn[0][1]), *drawn[1:]])
        assert net.layers[0].shift == 6  # kept as it is: exact in 8 bits
        given = rng.integers(-128, 128, (33, inputs)).astype(np.int8)
        given[0], given[1] = -128, 127
        for form, of in product(fast.net_forms(), (net, with_cases(net))):
            nets = entropy.NativeNets(form)
            nets.add([layer.given for layer in of.layers])
            np.testing.assert_array_equal(nets.run(given), networks.run(of, given))


@pytest.mark.parametrize("form", fast.net_forms())
@pytest.mark.parametrize("in_bytes", [False, True])
def test_tiles_without_weights_are_left_out_alike_on_every_processor(form: str, in_bytes: bool) -> None:
    rng = np.random.default_rng(8)
    for inputs, hidden in ((72, (24, 40)), (112, (192, 48)), (112, (256, 256)), (72, (8, 8))):
        drawn = float_layers(inputs, hidden, seed=hidden[0])
        if in_bytes:
            drawn[0] = rng.integers(-128, 128, drawn[0][0].shape) / 64, drawn[0][1]
        for share in (0.5, 0.02):
            net = with_cases(networks.quantised(inputs == 112, 2, without_tiles(drawn, share, rng)))
            given = rng.integers(-128, 128, (33, inputs)).astype(np.int8)
            nets = entropy.NativeNets(form)
            nets.add([layer.given for layer in net.layers])
            np.testing.assert_array_equal(nets.run(given), networks.run(net, given))


@pytest.mark.parametrize("step", sampled([1, 11, 501], [11]))
def test_every_path_writes_the_same_with_networks(step: int) -> None:
    width = 400
    fired, returns, ranges = all_fired(width), mask(width), scene(width)
    written = set()
    for path in fast.coding_paths():
        for form in entropy.net_forms():
            nets = entropy.NativeNets(form)
            for net in map(with_cases, four_nets()[1::2]):
                nets.add([layer.given for layer in net.layers])
            coder, reader = (entropy.PredictiveCoder(path, nets) for _ in range(2))
            data = b""
            for expected in (None, guess(ranges), guess(ranges, 6)):
                one = coder.encode(ranges, returns, fired, SENSOR, step, LEVELS, expected=expected)
                came = reader.decode(one, returns, fired, SENSOR, step, LEVELS, expected=expected)
                check_bound(came, ranges, returns, step)
                data += one
            written.add(data)
    assert len(written) == 1


def test_a_network_that_does_not_fit_is_refused() -> None:
    nets = entropy.NativeNets()
    layers = [layer.given for layer in four_nets()[0].layers]
    large, none = np.full_like(layers[1][0], 32767), layers[1][3]
    for wrong in (
        [layers[1], *layers[1:]],
        [layers[0], (layers[1][0], layers[1][1][:-1].copy(), 8, none), layers[2]],
        [layers[0], (layers[1][0], layers[1][1], 30, none), layers[2]],
        [layers[0], (large, np.full_like(layers[1][1], 2**31 - 1), 8, none), layers[2]],
        [layers[0], (*layers[1][:3], np.zeros((96, len(layers[1][1])), np.int8)), layers[2]],
        [(*layers[0][:3], np.zeros((95, len(layers[0][1])), np.int8)), *layers[1:]],
    ):
        with pytest.raises(SectionError):
            nets.add(wrong)
    with pytest.raises(SettingsError, match="processor"):
        entropy.NativeNets("abacus").add(layers)
    with pytest.raises(SectionError):
        nets.run(np.zeros((3, 112), np.int8))


def test_own_weights_travel_with_the_key_messages(own_file: Path) -> None:
    sent = drive(8)
    messages = messages_of(sent, settings(weights=str(own_file), effort=3))
    assert [message.has(SectionType.WEIGHTS) for message in messages] == [message.key for message in messages]
    for begin in (0, 4):  # whoever joins at a key message has all it needs
        reader = decoder()
        for message, frame in zip(messages[begin:], sent[begin:], strict=True):
            (came,) = reader.decode(message)
            np.testing.assert_array_equal(came.valid, frame.valid)
            assert np.abs(came.range.astype(int) - frame.range)[frame.valid].max() <= 5


def test_the_package_s_weights_do_not_travel() -> None:
    assert not any(message.has(SectionType.WEIGHTS) for message in messages_of(drive(5), settings()))


def test_weights_that_nobody_sent_are_asked_for(own_file: Path) -> None:
    key, *_ = messages_of(drive(1), settings(weights=str(own_file)))
    without = [section for section in key.sections if section.type != SectionType.WEIGHTS]
    with pytest.raises(MissingReferenceError, match="weights"):
        decoder().decode(Message(**{**vars(key), "sections": tuple(without)}))


def test_effort_and_weights_change_under_way(own_file: Path) -> None:
    encoder, reader = table.make_encoder(settings(), STREAM), decoder()
    own = str(own_file)
    plans = [settings(), settings(effort=1), settings(effort=4), settings(weights=own), settings(motion=False)]
    frame_index = 0
    for plan in plans:
        due = encoder.apply(plan)
        for i in range(3):
            frame = frames.scene(20, seed=frame_index, index=frame_index)
            frame_index += 1
            (message,) = encoder.encode(frame)
            assert message.key or not (due and i == 0)
            (came,) = reader.decode(wire.unpack(wire.pack(message)))
            assert np.abs(came.range.astype(int) - frame.range)[frame.valid].max() <= 5


def test_damaged_weights_raise_only_errors_of_decoding(own_file: Path) -> None:
    (key,) = messages_of(drive(1), settings(weights=str(own_file)))
    data = key.section(SectionType.WEIGHTS)
    others = [section for section in key.sections if section.type != SectionType.WEIGHTS]
    rng = np.random.default_rng(8)
    for i in range(200):
        broken = bytearray(data[: int(rng.integers(len(data)))] if i % 3 == 0 else data)
        for at in rng.integers(0, max(len(broken), 1), 3) if broken else ():
            broken[at] ^= int(rng.integers(1, 256))
        if i % 2 and len(broken) > 4:  # as somebody who can count would damage it
            broken[-4:] = int(fast_crc(bytes(broken[:-4]))).to_bytes(4, "little")
        message = Message(**{**vars(key), "sections": (*others, Section(SectionType.WEIGHTS, bytes(broken)))})
        try:
            decoder().decode(message)
        except DecodeError:
            continue


def test_a_message_full_of_weights_is_refused_before_they_are_read(own_file: Path) -> None:
    """Each takes milliseconds: two hundred of them would hold up whoever receives it for seconds."""
    (key,) = messages_of(drive(1), settings(weights=str(own_file)))
    brought = Section(SectionType.WEIGHTS, key.section(SectionType.WEIGHTS))
    with pytest.raises(SectionError, match="one file and one update"):
        decoder().decode(Message(**{**vars(key), "sections": (*key.sections, brought)}))
    updates = (Section(SectionType.WEIGHTS, b"LCRU"),) * 2
    with pytest.raises(SectionError, match="one file and one update"):
        decoder().decode(Message(**{**vars(key), "sections": (*key.sections, *updates)}))
    (came,) = decoder().decode(key)
    assert came.points > 0


def fast_crc(data: bytes) -> int:
    from lidarcodec._native import crc32c

    return int(crc32c(data))


def test_weights_for_one_kind_of_frames_do_for_no_stream(tmp_path: Path) -> None:
    alone = rf.pack_weights([net for net in four_nets() if not net.expects], {})
    (tmp_path / "alone.lcrw").write_bytes(alone)
    with pytest.raises(SettingsError, match="expecting"):
        table.make_encoder(settings(weights=str(tmp_path / "alone.lcrw")), STREAM)
    reader = decoder()
    (key,) = messages_of(drive(1), settings())
    ranges = bytearray(key.section(SectionType.RANGE))
    ranges[3:11] = bytes.fromhex(rf.unpack_weights(alone).name)
    others = [section for section in key.sections if section.type != SectionType.RANGE]
    brought = (Section(SectionType.RANGE, bytes(ranges)), Section(SectionType.WEIGHTS, alone))
    with pytest.raises(SectionError, match="without a network for frames of this kind"):
        reader.decode(Message(**{**vars(key), "sections": (*others, *brought)}))


def test_settings_say_what_is_wrong_with_weights(tmp_path: Path) -> None:
    (tmp_path / "none.lcrw").write_bytes(b"no weights")
    os.mkfifo(tmp_path / "pipe.lcrw")  # nobody will ever write to it
    encoder = table.make_encoder(settings(), STREAM)
    for path in (tmp_path / "none.lcrw", tmp_path / "missing.lcrw", tmp_path / "pipe.lcrw", tmp_path, Path("a\0b")):
        with pytest.raises(SettingsError, match="weight"):
            table.make_encoder(settings(weights=str(path)), STREAM)
        with pytest.raises(SettingsError, match="weight"):
            encoder.apply(settings(weights=str(path)))
    reader = decoder()
    for frame in drive(3):  # a refused change has changed nothing
        (message,) = encoder.encode(frame)
        assert reader.decode(wire.unpack(wire.pack(message)))
    with pytest.raises(SettingsError, match="effort"):
        table.make_encoder(settings(effort=9), STREAM)


def test_what_ships_may_be_shipped() -> None:
    weights = weights_of("")
    assert weights.name in shipped()
    assert "KITTI" not in str(weights.provenance.get("licence"))
    assert "trained on" in weights.provenance
    assert sum(len(each.data) for each in shipped().values()) < 300_000
    for effort in (2, 3, 4):
        native_nets(networks_of(weights, effort))


def test_what_takes_no_bits_takes_bytes_all_the_same() -> None:
    """A message that holds many returns in next to no bytes is refused before they are decoded."""
    same = frames.scene(400, holes=0.0)
    same = same.with_(range=np.full_like(same.range, 5000), intensity=np.full_like(same.intensity, 9))
    sent = [same.with_(index=index) for index in range(2)]
    messages = messages_of(sent, settings())
    for message in messages:
        assert message.has(SectionType.FILLER)
        assert sum(len(section.data) for section in message.sections) * RETURNS_PER_BYTE >= same.points
    whole = decoder()
    for message, frame in zip(messages, sent, strict=True):
        (came,) = whole.decode(message)
        np.testing.assert_array_equal(came.azimuth, frame.azimuth)
    sections = tuple(s for s in messages[1].sections if s.type != SectionType.FILLER)
    short = bytes(1199 - sum(len(section.data) for section in sections))
    readers = [decoder(), decoder()]
    for reader in readers:
        reader.decode(messages[0])
    for reader, fewer in zip(readers, (sections, (*sections, Section(SectionType.FILLER, short))), strict=True):
        with pytest.raises(SectionError, match=r"sections of \d+ bytes for 153600 returns: too few"):
            reader.decode(Message(**(messages[1].__dict__ | {"sections": fewer})))


def test_frames_of_a_scene_need_no_filler() -> None:
    for coarse in (0.0, 20.0):
        given = StreamSettings(codec="riddle", max_error_m=coarse, intensity="off")
        assert not any(message.has(SectionType.FILLER) for message in messages_of(drive(), given))
