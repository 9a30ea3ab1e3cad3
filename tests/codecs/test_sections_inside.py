"""The shared sections one by one: what a codec's own tests cannot see from outside."""

from __future__ import annotations

import numpy as np
import pytest

from lidarcodec.codecs import table
from lidarcodec.codecs.base import Decoder
from lidarcodec.entropy.zstd_frames import compress, decompress
from lidarcodec.errors import LidarCodecError, MissingReferenceError, SectionError, TruncatedError
from lidarcodec.frame import Frame
from lidarcodec.message import SectionType
from lidarcodec.pipeline import StreamEncoder
from lidarcodec.planes.calibrations import encode_calibration
from lidarcodec.planes.intensity import Quality, encode_intensity, values_within
from lidarcodec.planes.sections import fired_cells, pose_sections
from lidarcodec.sensor_model import Calibration, SensorModel
from lidarcodec.settings import StreamSettings
from tests.contracts import frames
from tests.planes.one_section import empty, read_intensity


def sensor_of(decoder: Decoder, data: bytes) -> SensorModel:
    """The sensor of a frame without columns, by its CALIBRATION section."""
    (frame,) = decoder.decode(empty(SectionType.CALIBRATION, data))
    return frame.sensor


def raw() -> Decoder:
    """A fresh decoder."""
    return table.make_decoder(table.codec_id("raw"))


@pytest.mark.parametrize("plain", [False, True])
def test_a_calibration_comes_back_and_its_hash_alone_suffices_then(plain: bool) -> None:
    sensor = frames.SENSOR.with_convention("veloview")
    decoder = raw()
    came = sensor_of(decoder, encode_calibration(sensor, key=True, plain=plain))
    assert (came.hash, came.convention, came.name, came.origin) == (sensor.hash, "veloview", "HDL-64E", "message")
    assert came.range_step_m == 0.002
    np.testing.assert_array_equal(came.calibration.table, sensor.calibration.table)
    short = encode_calibration(sensor, key=False)
    assert len(short) == 9
    assert sensor_of(decoder, short) is came


def test_a_hash_without_its_table_asks_for_a_key_frame() -> None:
    with pytest.raises(MissingReferenceError, match="key frame") as caught:
        sensor_of(raw(), encode_calibration(frames.SENSOR, key=False))
    assert caught.value.needs == 7


def test_a_decoder_does_not_collect_calibrations_without_end() -> None:
    decoder = raw()
    for seed in range(20):
        sensor_of(decoder, encode_calibration(frames.sensor(seed), key=True))
    for seed in range(12, 20):
        sensor_of(decoder, encode_calibration(frames.sensor(seed), key=False))
    with pytest.raises(MissingReferenceError):
        sensor_of(decoder, encode_calibration(frames.sensor(11), key=False))


def test_a_calibration_that_lies_about_its_hash_is_refused() -> None:
    data = bytearray(encode_calibration(frames.SENSOR, key=True, plain=True))
    data[-1] ^= 1
    with pytest.raises(SectionError, match="calls itself"):
        sensor_of(raw(), bytes(data))


@pytest.mark.parametrize(
    "data",
    [b"", b"\0", b"\3" + bytes(8), b"\0" + bytes(9), b"\1" + bytes(8), b"\1" + bytes(14), b"\2" + bytes(3000)],
)
def test_damaged_calibrations_are_refused(data: bytes) -> None:
    with pytest.raises(SectionError):
        sensor_of(raw(), data)


def test_a_sensor_that_does_not_fit_is_refused_by_the_encoder() -> None:
    zeros = Calibration(np.zeros((11, 64), np.int32))
    with pytest.raises(SectionError, match="does not fit"):
        encode_calibration(SensorModel("x" * 300, zeros), key=True)


def test_an_error_takes_as_few_values_as_the_intensities_need() -> None:
    every = np.arange(256)
    for error in range(1, 128):
        table = values_within(np.ones(256, np.intp), error).astype(int)
        assert np.abs(table - every).max() <= error
        assert (np.diff(table) >= 0).all()
        assert len(np.unique(table)) == -(-256 // (2 * error + 1))
    counts = np.zeros(256, np.intp)
    counts[[3, 4, 8, 9, 200]] = [1, 9, 1, 1, 5]
    table = values_within(counts, 3)
    assert table[[3, 4, 8, 9, 200]].tolist() == [6, 6, 6, 6, 200]  # near the mean, 4.7, as far as the bound lets it
    np.testing.assert_array_equal(values_within(np.zeros(256, np.intp), 9), every)


@pytest.mark.parametrize("grouped", [False, True])
def test_intensities_without_return_cost_nothing_where_they_are_zero(grouped: bool) -> None:
    frame = frames.scene(4)
    cells = np.ones(frame.range.shape, np.bool_)
    data = encode_intensity(frame, cells, Quality(256), grouped=grouped)
    assert data is not None
    assert data[0] == (0 if grouped else 3)
    np.testing.assert_array_equal(read_intensity(data, frame.valid, frame.fired, frames.SENSOR), frame.intensity)


@pytest.mark.parametrize("grouped", [False, True])
@pytest.mark.parametrize("quality", [Quality(2), Quality(16), Quality(255), Quality(256), Quality(29, 4)], ids=str)
@pytest.mark.parametrize(
    "frame", [frames.scene(4), frames.noise(3), frames.one_return()], ids=["scene", "noise", "one"]
)
def test_intensities_come_back_in_every_form(frame: Frame, quality: Quality, grouped: bool) -> None:
    cells = fired_cells(frame.fired, frame.sensor)
    data = encode_intensity(frame, cells, quality, grouped=grouped)
    assert data is not None
    came = read_intensity(data, frame.valid, frame.fired, frame.sensor)
    if quality.lossless:
        np.testing.assert_array_equal(came, frame.intensity)
        return
    assert data[0] == (2 if grouped else 5)
    assert not came[~frame.valid].any()
    before, after = frame.intensity[frame.valid].astype(int), came[frame.valid].astype(int)
    if quality.error:
        assert np.abs(after - before).max(initial=0) <= quality.error
    elif len(np.unique(before)) <= quality.levels:
        np.testing.assert_array_equal(after, before)
    else:
        assert len(np.unique(after)) <= quality.levels


@pytest.mark.parametrize(
    "data",
    [
        b"", b"\0", b"\0\1abc", b"\1\0\0", b"\2", b"\2\7", b"\1\xff\xff\xff\xff",
        b"\3", b"\3abc", b"\3\0\7\7", b"\4", b"\4\2\0\0\0\0\7", b"\4\xff\xff\xff\xff\0", b"\5", b"\5\0\7\7",
        b"\2\xff\7", b"\6\0\7", b"\xff",
    ],
)  # fmt: skip
def test_damaged_intensities_are_refused(data: bytes) -> None:
    frame = frames.scene(2)
    with pytest.raises((SectionError, TruncatedError)):
        read_intensity(data, frame.valid, frame.fired, frames.SENSOR)


def test_modelled_intensities_are_a_good_deal_smaller() -> None:
    frame = frames.scene(60)
    sizes = [
        len(encode_intensity(frame, fired_cells(frame.fired, frames.SENSOR), Quality(256), grouped=grouped) or b"")
        for grouped in (False, True)
    ]
    assert sizes[0] < 0.9 * sizes[1]


def test_a_zstd_frame_must_say_the_size_that_is_expected() -> None:
    data = compress(bytes(1000), 3)
    assert decompress(data, 1000) == bytes(1000)
    for wrong in (data[:-1], data + b"\0", data[1:], b"", data * 2):
        with pytest.raises(SectionError):
            decompress(wrong, 1000)
    for size in (0, 999, 1001, 2**62):
        with pytest.raises(SectionError, match="1000"):
            decompress(data, size)


def test_a_pose_must_be_a_rigid_transform() -> None:
    frame = frames.scene(1)
    flat, mirrored = np.diag([1.0, 1.0, 0.0, 1.0]), np.diag([1.0, -1.0, 1.0, 1.0])
    for wrong in (np.full((4, 4), np.nan), np.zeros((4, 4)), np.ones((4, 4)), flat, mirrored):
        with pytest.raises(LidarCodecError, match="pose"):
            pose_sections(frame.with_(pose=wrong))
        encoder = StreamEncoder(StreamSettings(codec="predictive", codec_settings={"motion": True}))
        for index in range(2):
            encoder.encode(frame.with_(pose=np.eye(4), index=index, stamp_ns=10**8 * index))
        with pytest.raises(LidarCodecError, match="pose"):  # also where the motion is taken from poses
            encoder.encode(frame.with_(pose=wrong, index=2, stamp_ns=2 * 10**8))
    for data in (bytes(95), bytes(97), b"\xff" * 96):
        with pytest.raises(SectionError, match="pose"):
            raw().decode(empty(SectionType.POSE, data))


def test_a_pose_that_no_encoder_writes_is_refused() -> None:
    far, sheared = np.eye(4), np.eye(4)
    far[0, 3], sheared[0, 1] = 1e12, 5.0
    stretched = np.diag([1e150, 1e-150, 1.0, 1.0])  # its determinant is 1
    for wrong in (np.full((4, 4), 1e308), np.zeros((4, 4)), np.diag([1.0, -1.0, 1.0, 1.0]), far, sheared, stretched):
        with pytest.raises(SectionError, match="no rigid transform"):
            raw().decode(empty(SectionType.POSE, wrong[:3].astype("<f8").tobytes()))
    rounded = np.round(frames.pose(), 3)
    (frame,) = raw().decode(empty(SectionType.POSE, rounded[:3].astype("<f8").tobytes()))
    assert frame.pose is not None
    np.testing.assert_array_equal(frame.pose, rounded)
