"""What a user of another sensor would lose who codes ranges as pictures: a return, a plane beside, a bound, a frame."""

from __future__ import annotations

import random
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from lidarcodec import _native, wire
from lidarcodec.assembly import packets_of
from lidarcodec.codecs import table
from lidarcodec.codecs.other_sensors import KINDS
from lidarcodec.entropy.zstd_frames import decompress
from lidarcodec.errors import DecodeError, MissingReferenceError, SectionError, SettingsError, UnsupportedVersionError
from lidarcodec.evaluation.round_trip import RoundTrip
from lidarcodec.evaluation.verify import promise_of
from lidarcodec.frame import Frame
from lidarcodec.frame_images import images_of, layout_of
from lidarcodec.message import Message, SectionType
from lidarcodec.pipeline import StreamDecoder, StreamEncoder, frames_of
from lidarcodec.planes.lattice_section import inflated
from lidarcodec.sensors.clouds.sensor import cloud_sensor
from lidarcodec.sensors.models.table import any_packets
from lidarcodec.settings import settings_from
from tests.codecs.test_other_sensors import FILES, SMALL, assert_exact, disturbed, opened, used
from tests.contracts import frames as made
from tests.fuzz.mutations import mutated
from tests.point_clouds import message as cloud_message
from tests.point_clouds import velodyne
from tests.sweeps import sampled

PICTURES = [name for name in table.installed() if name not in KINDS]
EXACT = [name for name in PICTURES if table.codec(name).bounded]
LOSSY = [name for name in PICTURES if not table.codec(name).bounded]
VIDEO = [name for name in PICTURES if name.startswith("h264")]
ODD_ROWS = "pandar40p"
"""40 rows: no multiple of 16."""
OWN = {"jpeg-layered": {"group": 2}, "h264": {"crf": 4.0}, "h264-log": {"crf": 4.0}}


def framed(capture: str, packets: int = 16, skip: int = 0) -> Frame:
    """A short frame of a capture."""
    sensor, of = opened(FILES[capture])
    return next(iter(frames_of(of[skip : skip + packets], sensor, f"packets:{packets}")))


def there_and_back(frames: list[Frame], codec: str, **settings: object) -> list[tuple[Frame, Message, Frame]]:
    """Each frame as it was encoded, its message, and what a receiver has; compared as recordings are."""
    wanted = settings_from({"codec": codec, "codec_settings": OWN.get(codec, {}), **settings})
    encoder, check = StreamEncoder(wanted, 7), RoundTrip(wanted)
    messages, encoded = [], []
    for frame in frames:
        messages += encoder.encode(frame)
        assert encoder.reduced is not None
        encoded.append(encoder.reduced)
        check.sent(encoder.reduced)
    messages += encoder.flush()
    came = [(one, frame) for one in messages for frame in check.message(wire.pack(one))]
    check.end()
    return [(sent, message, decoded) for sent, (message, decoded) in zip(encoded, came, strict=True)]


def off_m(frame: Frame, decoded: Frame) -> np.ndarray:
    """(N,) errors of the ranges of returns, in metres."""
    off = np.abs(decoded.range.astype(np.int64) - frame.range)[frame.valid]
    return off * frame.sensor.range_step_m


@pytest.mark.parametrize("codec", PICTURES)
@pytest.mark.parametrize("capture", sampled([*SMALL, ODD_ROWS], ["vlp16", ODD_ROWS]))
def test_returns_packets_and_planes_beside_come_back_and_ranges_are_near(capture: str, codec: str) -> None:
    frames = [framed(capture, skip=16 * at).with_(index=at) for at in range(2)]
    for sent, message, decoded in there_and_back(frames, codec):
        found = layout_of(sent)
        assert found is not None
        before, after = (images_of(one, found[1]).planes for one in (sent, decoded))
        for form in found[1].planes:
            if form.role == "attribute":
                np.testing.assert_array_equal(after[form.name], before[form.name])
            else:
                np.testing.assert_array_equal(after[form.name] > 0, before[form.name] > 0)
        assert len(packets_of(decoded)) == len(packets_of(sent))
        assert promise_of(message).identical == (codec in EXACT)
        if codec in EXACT:
            assert [one.payload for one in packets_of(decoded)] == [one.payload for one in packets_of(sent)]
        assert np.sqrt(np.square(off_m(sent, decoded)).mean()) < 0.15
        if "range2" in before:  # a second return that is the first one again is that again
            same = (before["range2"] == before["range"]) & (before["range"] > 0)
            np.testing.assert_array_equal(after["range2"][same], after["range"][same])
            np.testing.assert_array_equal(after["range2"][~same], before["range2"][~same])


@pytest.mark.parametrize("codec", EXACT)
@pytest.mark.parametrize("capture", sampled(SMALL, ["xt32m"]))
def test_a_bound_is_kept_at_every_return_of_both_ranges(capture: str, codec: str) -> None:
    ((sent, message, decoded),) = there_and_back([framed(capture)], codec, max_error_m=0.05)
    for name in {"range", "range2"} & {"range", *sent.planes}:
        before, after = ({"range": one.range, **one.planes}[name].astype(np.int64) for one in (sent, decoded))
        assert 0 < np.abs(after - before).max() * sent.sensor.range_step_m <= 0.05
    assert not promise_of(message).identical
    assert promise_of(message).step == 2 * int(0.05 / sent.sensor.range_step_m + 1e-9) + 1


@pytest.mark.parametrize("codec", EXACT)
@pytest.mark.parametrize("capture", sampled(SMALL, ["vlp16"]))
def test_packets_of_a_bad_line_come_back_too(capture: str, codec: str) -> None:
    sensor, packets = opened(FILES[capture])
    assert_exact(disturbed(packets[:60], random.Random(3)), sensor, codec)


def far_frame() -> Frame:
    """A frame of an Ouster whose ranges reach to 19 bits, with second returns near them and near 0."""
    frame = framed(SMALL[2])
    ranges = frame.range.copy()
    ranges[0, :7] = (1, 65_535, 65_536, 65_537, (1 << 19) - 1, 1 << 18, 0)
    second = frame.planes["range2"].copy()
    second[0, :7] = (1, 1, 2, 65_537, (1 << 19) - 1, 17, 5)
    second[1, :4] = (1, 2, 16, 17)
    return frame.with_(range=ranges, planes={**frame.planes, "range2": second})


@pytest.mark.parametrize("codec", EXACT)
@pytest.mark.parametrize("bound", [None, 0.003, 20.0])
def test_ranges_of_more_than_16_bits_are_exact_or_within_the_bound(codec: str, bound: float | None) -> None:
    ((sent, _, decoded),) = there_and_back([far_frame()], codec, max_error_m=bound)
    assert off_m(sent, decoded).max() <= (bound or 0.0) + 1e-9
    second = np.abs(decoded.planes["range2"].astype(np.int64) - sent.planes["range2"])
    assert second.max() * 0.001 <= (bound or 0.0) + 1e-9


@pytest.mark.parametrize("codec", LOSSY)
def test_samples_reach_to_the_farthest_range(codec: str) -> None:
    fine = {"crf": 1.0} if codec in VIDEO else {"quality": 100}
    frame = far_frame()
    wide = frame.with_(range=np.where(frame.range > 0, 200_000 + frame.range // 2, 0).astype(np.uint32))
    ((sent, _, decoded),) = there_and_back([wide], codec, codec_settings=fine)
    assert np.median(off_m(sent, decoded)) < 0.5
    second = sent.planes["range2"]
    np.testing.assert_array_equal(decoded.planes["range2"][(second == 1) & (sent.range > 0)], 2)


@pytest.mark.parametrize("codec", PICTURES)
@pytest.mark.parametrize("reduction", sampled(["columns:3", "lattice:3", "random"], ["lattice:3"]))
def test_a_dropped_return_is_none_in_all_planes(reduction: str, codec: str) -> None:
    for capture in SMALL[:2]:
        frames = [framed(capture, skip=16 * at).with_(index=at) for at in range(2)]
        for sent, message, decoded in there_and_back(frames, codec, reduction=reduction, intensity="levels=4"):
            np.testing.assert_array_equal(decoded.range > 0, sent.valid)
            assert promise_of(message).reduced
            if sent.lattice is not None:
                np.testing.assert_array_equal(decoded.lattice, sent.lattice)


@pytest.mark.parametrize("codec", PICTURES)
def test_frames_without_returns_or_without_images_may_stand_between_others(codec: str) -> None:
    frame = framed("vlp16")
    nothing = {name: np.zeros_like(image) for name, image in frame.planes.items()}
    empty = frame.with_(range=np.zeros_like(frame.range), planes=nothing)
    sensor, _ = opened(FILES["vlp16"])
    (odd,) = frames_of(list(packets_of(framed("xt32m"))), sensor)
    assert layout_of(odd) is None
    frames = [one.with_(index=index) for index, one in enumerate((empty, frame, odd, empty, frame, odd, frame))]
    for key in (None, 4, 5):
        wanted = settings_from({"codec": codec})
        encoder, decoder = StreamEncoder(wanted, 7), StreamDecoder()
        sent = [one for frame in frames for one in encoder.encode(frame, key=frame.index == key)] + encoder.flush()
        came = [frame for one in sent for frame in decoder.decode(wire.unpack(wire.pack(one)))]
        assert [one.points for one in came] == [one.points for one in frames]
        if key is not None:  # who joins at the key message has all from there on
            fresh, late = StreamDecoder(), []
            for one in sent[next(at for at, one in enumerate(sent) if one.key and one.frame_index == key) :]:
                late += fresh.decode(one)
            assert [one.points for one in late] == [one.points for one in frames[key:]]


@pytest.mark.parametrize("codec", VIDEO)
def test_after_a_lost_picture_a_key_message_is_needed(codec: str) -> None:
    frames = [framed("vlp16").with_(index=at) for at in range(5)]
    encoder, decoder = StreamEncoder(settings_from({"codec": codec}), 7), StreamDecoder()
    messages = [one for frame in frames for one in encoder.encode(frame, key=frame.index == 4)]
    assert [one.needs for one in messages] == [None, 0, 1, 2, None]
    decoder.decode(messages[0])
    for lost in messages[2:4]:
        with pytest.raises(MissingReferenceError):
            decoder.decode(lost)
    assert len(decoder.decode(messages[4])) == 1


def test_a_group_ends_with_its_sensor_and_new_settings_go_on_in_it() -> None:
    if "jpeg-layered" not in PICTURES:
        pytest.skip("jpeg-layered is not installed")
    vlp16, os0, hdl64e = framed("vlp16"), framed(SMALL[2]), made.scene(4)
    settings = settings_from({"codec": "jpeg-layered", "codec_settings": {"group": 3}})
    encoder, decoder = StreamEncoder(settings, 7), StreamDecoder()
    sent, messages = [], []
    for index, of in enumerate((vlp16, vlp16, os0, hdl64e, hdl64e, vlp16, vlp16, vlp16)):
        sent.append(of.with_(index=index))
        if index == 6:
            encoder.apply(encoder.settings.changed(codec_settings={"group": 3, "quality": 50}))
        messages += encoder.encode(sent[-1])
    messages += encoder.flush()
    came = [frame for one in messages for frame in decoder.decode(wire.unpack(wire.pack(one)))]
    assert [one.index for one in came] == [one.index for one in sent]
    assert [one.frame_count for one in messages] == [2, 1, 2, 3]
    for before, after in zip(sent, came, strict=True):
        assert after.sensor.hash == before.sensor.hash
        np.testing.assert_array_equal(after.range > 0, before.range > 0)


@pytest.mark.parametrize("codec", PICTURES)
def test_damaged_messages_are_decode_errors(codec: str) -> None:
    rng, found = random.Random(4), Counter[bool]()
    for capture in SMALL[:2]:
        frames = [framed(capture, 6).with_(index=at) for at in range(2)]
        message = there_and_back(frames, codec)[0][1]
        for _ in range(40):
            at = rng.choice([at for at, one in enumerate(message.sections) for _ in range(1 + 3 * (one.type == 1))])
            sections = list(message.sections)
            sections[at] = sections[at]._replace(data=mutated(sections[at].data, rng))
            width = rng.choice((message.width, message.width, 0, message.width - 1))
            try:
                used(wire.unpack(wire.pack(replace(message, sections=tuple(sections), width=width))))
                found[True] += 1
            except DecodeError:
                found[False] += 1
    assert found[False] > 20


@pytest.mark.parametrize("codec", PICTURES)
def test_sensors_without_images_say_what_to_do(codec: str) -> None:
    (odd,) = frames_of(list(packets_of(framed("xt32m"))), any_packets())
    ((_, _, decoded),) = there_and_back([odd], codec)
    assert [one.payload for one in packets_of(decoded)] == [one.payload for one in packets_of(odd)]
    sensor = cloud_sensor([cloud_message(velodyne(20))])
    with pytest.raises(SettingsError, match=f"codec {codec} takes no point clouds: choose one of raw, zstd") as caught:
        StreamEncoder(settings_from({"codec": codec}), 1).prepare(sensor)
    assert caught.value.field == "codec"


@pytest.mark.parametrize("codec", PICTURES[:1])
def test_decoders_that_open_no_pictures_refuse_them_by_name(codec: str) -> None:
    ((_, message, _),) = there_and_back([framed("vlp16", 12)], codec)
    session = _native.Session(decompress, inflated, lambda _: None, False)
    with pytest.raises(UnsupportedVersionError, match=f"codec {codec}"):
        session.decode_images(message)
    assert message.has(SectionType.PLANES)


@pytest.mark.parametrize("most", [1, 40_000])
def test_a_group_has_no_more_numbers_than_a_decoder_takes(monkeypatch: pytest.MonkeyPatch, most: int) -> None:
    if "jpeg-layered" not in PICTURES:
        pytest.skip("jpeg-layered is not installed")
    frames = [framed("vlp16", 6).with_(index=at) for at in range(3)]
    whole = there_and_back(frames, "jpeg-layered", codec_settings={"group": 3})[0][1]
    monkeypatch.setattr("lidarcodec.codecs.jpeg_layered.MAX_NUMBERS", most)
    settings = settings_from({"codec": "jpeg-layered", "codec_settings": {"group": 3}})
    encoder = StreamEncoder(settings, 7)
    counts = [one.frame_count for frame in frames for one in encoder.encode(frame)]
    assert sum(counts + [one.frame_count for one in encoder.flush()]) == 3
    if most == 1:
        assert set(counts) == {1}
        with pytest.raises(DecodeError, match="1 are possible"):
            StreamDecoder().decode(whole)


@pytest.mark.parametrize("codec", PICTURES)
def test_planes_that_no_encoder_writes_beside_a_picture_are_refused(codec: str) -> None:
    """A plane named `ranger` would stay without its ranges, and a step would stretch ranges that keep no bound."""
    ((_, message, _),) = there_and_back([framed("vlp16")], codec)
    planes = message.section(SectionType.PLANES)
    wounded = {SectionType.PLANES: planes.replace(b"\x06range2", b"\x06ranger", 1)}
    assert wounded[SectionType.PLANES] != planes
    if codec in LOSSY:
        ranges = message.section(SectionType.RANGE)
        assert ranges[1] == 1
        wounded[SectionType.RANGE] = ranges[:1] + b"\x03" + ranges[2:]
    for kind, data in wounded.items():
        sections = tuple(one._replace(data=data) if one.type == kind else one for one in message.sections)
        with pytest.raises(SectionError):
            StreamDecoder().decode(replace(message, sections=sections))
