"""`h264`: pictures that refer to one another, FFmpeg fed with what it must not see, frames of every width in a row."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lidarcodec.codecs import table
from lidarcodec.errors import LidarCodecError, MissingReferenceError, SectionError
from lidarcodec.frame import Frame
from lidarcodec.message import Message, SectionType
from lidarcodec.ranges.video.h264_stream import PRESETS, PictureReader, PictureWriter, Preset
from lidarcodec.ranges.video.h264_units import check_sequence, split_units
from lidarcodec.settings import settings_from
from tests.contracts import frames

RNG = np.random.default_rng(5)
PICTURE = (np.cumsum(RNG.integers(-4, 5, (64, 96)), axis=1) + 500).clip(0, 1023).astype(np.uint16)


def encoded(sent: list[Frame], codec: str = "h264", **own: object) -> list[Message]:
    """Messages of frames."""
    encoder = table.make_encoder(settings_from({"codec": codec, "codec_settings": own, "key_interval": 100}), 3)
    return [message for frame in sent for message in encoder.encode(frame)]


def rmse_m(messages: list[Message], sent: list[Frame]) -> float:
    """Root of the mean squared error of decoded ranges."""
    decoder = table.make_decoder(messages[0].codec)
    came = [frame for message in messages for frame in decoder.decode(message)]
    errors = [(a.range.astype(float) - b.range)[b.valid] for a, b in zip(came, sent, strict=True)]
    return 0.002 * float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))


@pytest.mark.parametrize("bits", [8, 10])
@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("crf", [0.0, 4.0])
def test_a_picture_comes_back_nearly(bits: int, preset: Preset, crf: float) -> None:
    """With every preset: x264 writes another profile for what it thinks is lossless."""
    picture = PICTURE >> (10 - bits)
    writer, reader = PictureWriter(64, 96, bits, crf, preset), PictureReader(64, 96, bits)
    for number in range(3):
        came = reader.read(writer.write(picture, idr=not number), idr=not number)
        assert np.abs(came.astype(int) - picture).mean() < 4


def test_a_finer_quality_errs_less_and_takes_more() -> None:
    sent = [frames.scene(40, index=index) for index in range(3)]
    fine, coarse = (encoded(sent, crf=crf) for crf in (2.0, 30.0))
    assert rmse_m(fine, sent) < rmse_m(coarse, sent) / 3
    assert sum(len(m.section(SectionType.RANGE)) for m in fine) > 2 * sum(
        len(m.section(SectionType.RANGE)) for m in coarse
    )


def test_what_stands_still_costs_next_to_nothing() -> None:
    """Prediction over time at work, although frames begin at another azimuth each time."""
    turn = frames.scene(349, holes=0.1)
    azimuth = (np.arange(2094) * 36000 // 2094).astype(np.uint16)
    sent = []
    for index in range(3):
        columns = (np.arange(2088) + 2088 * index) % 2094
        images = {
            name: np.ascontiguousarray(getattr(turn, name)[:, columns]) for name in ("range", "intensity", "fired")
        }
        sent.append(turn.with_(index=index, side=None, azimuth=np.tile(azimuth[columns], (2, 1)), **images))
    first, *others = [len(message.section(SectionType.RANGE)) for message in encoded(sent, crf=12)]
    assert max(others) < first / 4


def test_a_lost_picture_is_noticed_until_the_next_one_that_needs_none() -> None:
    """FFmpeg would go on without a word, and every range would be wrong."""
    sent = [frames.scene(3).with_(index=index) for index in range(6)]
    messages = encoded(sent)
    assert [message.needs for message in messages] == [None, 0, 1, 2, 3, 4]
    decoder = table.make_decoder(messages[0].codec)
    decoder.decode(messages[0])
    for late in messages[2:]:
        with pytest.raises(MissingReferenceError):
            decoder.decode(late)


def test_a_new_quality_begins_anew_without_a_key_message() -> None:
    """The calibration is known already: it would cost more than a coarse picture."""
    encoder = table.make_encoder(settings_from({"codec": "h264", "key_interval": 100}), 3)
    decoder = table.make_decoder(table.codec_id("h264"))
    kinds = []
    for index, crf in enumerate((20.0, 20.0, 26.0, 26.0)):
        assert encoder.apply(settings_from({"codec": "h264", "codec_settings": {"crf": crf}, "key_interval": 100})) == (
            index == 0
        )
        (message,) = encoder.encode(frames.scene(3).with_(index=index))
        decoder.decode(message)
        kinds.append((message.key, message.needs))
    assert kinds == [(True, None), (False, 0), (False, None), (False, 2)]


@pytest.mark.sweep
def test_frames_of_every_width_follow_one_another() -> None:
    """`revolution` framing changes the width with each frame; a slab can be a single packet; nothing is refused."""
    sent = [frames.scene(packets, seed=4) for packets in (348, 361, 29, 1, 348, 700)]
    sent += [frames.ordinary()["odd width"], frames.ordinary()["empty"], frames.scene(29, seed=4)]
    sent = [frame.with_(index=index) for index, frame in enumerate(sent)]
    for codec in ("h264", "h264-log"):
        messages = encoded(sent, codec, crf=2.0)
        assert rmse_m(messages, sent) < 1.0


def test_slabs_and_revolutions_of_one_turn_stay_in_one_stream() -> None:
    """A picture that needs none is ten times as large: the width alone must not cause one."""
    sent, column = [], 0
    for index, packets in enumerate((29, 30, 29, 28, 29, 29)):
        slab = frames.scene(packets, seed=4)
        azimuth = ((column + np.arange(slab.width)) * 17 % 36000).astype(np.uint16)
        sent.append(slab.with_(index=index, azimuth=np.tile(azimuth, (2, 1))))
        column += slab.width
    assert [message.needs for message in encoded(sent)] == [None, 0, 1, 2, 3, 4]


def test_a_farther_return_than_before_is_not_cut_off() -> None:
    near = frames.scene(4)
    ranges = near.range.copy()
    ranges[near.valid.nonzero()[0][0], near.valid.nonzero()[1][0]] = 65535
    sent = [near.with_(range=np.minimum(near.range, 9000)), near.with_(range=ranges, index=1)]
    messages = encoded(sent, crf=0.0)
    assert messages[1].needs is None
    decoder = table.make_decoder(messages[0].codec)
    last = [decoder.decode(message)[0] for message in messages][-1]
    assert abs(int(last.range.max()) - 65535) < 1500


def test_the_paper_mapping_is_worse_than_the_one_that_fills_the_samples() -> None:
    sent = [frames.scene(40, index=index) for index in range(2)]
    assert rmse_m(encoded(sent, "h264-log", crf=0.0), sent) < rmse_m(
        encoded(sent, "h264-log", crf=0.0, mapping="paper"), sent
    )


def access_unit(bits: int = 10, rows: int = 64, columns: int = 96) -> bytes:
    """An IDR picture."""
    picture = np.tile(PICTURE >> (10 - bits), (-(-rows // 64), -(-columns // 96)))[:rows, :columns]
    return PictureWriter(rows, columns, bits, 20.0, "fast").write(picture, idr=True)


def test_pictures_of_other_sides_or_depth_never_reach_ffmpeg() -> None:
    """Sequence parameters that claim 16384 x 16384 would make it take gigabytes."""
    for data in (access_unit(8), access_unit(rows=128), access_unit(columns=112), access_unit(columns=8192)):
        with pytest.raises(SectionError, match=r"\d"):
            PictureReader(64, 96, 10).read(data, idr=True)


def test_access_units_with_anything_more_or_less_are_refused() -> None:
    good = access_unit()
    sequence, picture, slice_ = split_units(good)
    start = b"\0\0\1"
    remark = b"\x06\x05\x04abcd\x80"
    wrong = [
        b"",
        b"abc",
        good[3:],
        start + slice_,
        start + sequence + start + picture,
        good + start + slice_,
        start + remark + good,
        good + start + sequence,
        start + picture + start + sequence + start + slice_,
        good[: len(good) // 2],
        start * 5,
    ]
    for data in wrong:
        with pytest.raises(SectionError):
            PictureReader(64, 96, 10).read(data, idr=True)
    with pytest.raises(SectionError):
        PictureReader(64, 96, 10).read(good, idr=False)


def test_sequence_parameters_cut_anywhere_are_refused_or_right() -> None:
    sequence = split_units(access_unit())[0]
    check_sequence(sequence, 64, 96, 10)
    for size in range(1, 8):
        with pytest.raises(SectionError):
            check_sequence(sequence[:size], 64, 96, 10)
    with pytest.raises(SectionError):
        check_sequence(sequence[:4] + bytes(500), 64, 96, 10)


def test_a_picture_that_libx264_cannot_write_is_an_error_of_ours() -> None:
    with pytest.raises(LidarCodecError):
        PictureWriter(64, 16400, 10, 20.0, "fast").write(np.zeros((64, 16400), np.uint16), idr=True)


def test_a_part_of_a_turn_is_refused() -> None:
    """No encoder of videos goes on from a part: its message would be one of another stream."""
    first, second = encoded([frames.scene(40, index=index) for index in range(2)])
    decoder = table.make_decoder(first.codec)
    decoder.decode(first)
    with pytest.raises(SectionError, match="part of a turn"):
        decoder.decode(replace(second, goes_on=True))
    assert decoder.decode(second)
