"""What two processes say to each other: frames come over whole, errors keep their type, and nonsense is refused."""

from __future__ import annotations

import socket
import struct
import time

import numpy as np
import pytest

from lidarcodec import errors
from lidarcodec.apps.worker.frames import FrameReader, FrameWriter
from lidarcodec.apps.worker.wire import (
    HEAD,
    Channel,
    GarbledError,
    Kind,
    error_bytes,
    message_parts,
    read_error,
    take_messages,
)
from lidarcodec.errors import LidarCodecError
from lidarcodec.frame import Frame
from tests.contracts import frames

SOON_S = 30.0


@pytest.fixture
def ends():
    """Two ends of a channel."""
    ours, theirs = socket.socketpair()
    yield Channel(ours), Channel(theirs)
    ours.close()
    theirs.close()


def crossed(ends, sent: list[Frame]) -> list[Frame]:
    """Frames over the channel, by one writer and one reader."""
    writer, reader, came = FrameWriter(), FrameReader(), []
    for frame in sent:
        end = time.monotonic() + SOON_S
        ends[0].say(Kind.FRAMES, writer.parts(frame), number=1, end=end)
        assert ends[1].head(end).number == 1
        came.append(reader.take(ends[1], end))
    return came


def assert_identical(came: Frame, sent: Frame) -> None:
    """Every field, bit by bit."""
    assert (came.index, came.stamp_ns) == (sent.index, sent.stamp_ns)
    for name in ("range", "intensity", "azimuth", "fired", "keep", "pose"):
        mine, theirs = getattr(came, name), getattr(sent, name)
        assert (mine is None) == (theirs is None), name
        if mine is not None:
            assert mine.dtype == theirs.dtype
            np.testing.assert_array_equal(mine, theirs, err_msg=name)
            assert not mine.flags.writeable
    assert (came.side is None) == (sent.side is None)
    if came.side is not None:
        for name in ("packet_ns", "gps_us", "status", "layouts", "layout", "irregular", "second"):
            np.testing.assert_array_equal(getattr(came.side, name), getattr(sent.side, name), err_msg=name)
        assert came.side.positions == sent.side.positions
    for name in ("hash", "name", "origin", "convention", "range_step_m"):
        assert getattr(came.sensor, name) == getattr(sent.sensor, name)


def test_every_field_of_a_frame_comes_over(ends):
    sent = list(frames.ordinary().values())
    sent.append(sent[0].with_(keep=np.random.default_rng(1).random(sent[0].range.shape) > 0.5))
    for came, one in zip(crossed(ends, sent), sent, strict=True):
        assert_identical(came, one)


def test_a_sensor_is_told_once_and_again_when_it_changes(ends):
    one = frames.scene(2)
    other = one.with_(sensor=one.sensor.with_convention("veloview"))
    first, second, third, fourth = crossed(ends, [one, one, other, one])
    assert first.sensor is second.sensor
    assert (third.sensor.convention, fourth.sensor.convention) == ("veloview", "ros")


SAMPLES = [
    errors.DecodeError("no", 7),
    errors.PacketError("no", 3),
    errors.HeaderError("no", 1),
    errors.UnsupportedVersionError("no", 12),
    errors.TruncatedError("no", 4),
    errors.ChecksumError("no"),
    errors.SectionError("no", 99),
    errors.MissingReferenceError("no", 41),
    errors.SettingsError("no", "codec_settings.crf"),
    errors.SettingsError("no"),
    errors.CalibrationError("no"),
    errors.UnknownNameError("codec", "x", ["a", "b"]),
    errors.MissingExtraError("this", "peers"),
    errors.MissingCodecError("this", "video"),
    errors.SourceError("no"),
    errors.TransportError("no"),
    errors.LidarCodecError("no"),
]


@pytest.mark.parametrize("error", SAMPLES, ids=lambda error: type(error).__name__)
def test_an_error_arrives_as_what_it_was(error):
    came = read_error(error_bytes(error))
    assert isinstance(came, LidarCodecError)
    assert (type(came), str(came), vars(came)) == (type(error), str(error), vars(error))


def test_an_error_that_is_none_of_ours_arrives_as_text():
    assert read_error(error_bytes(ZeroDivisionError("by nothing"))) == "ZeroDivisionError: by nothing"
    assert read_error(error_bytes(MemoryError())) == "MemoryError"


@pytest.mark.parametrize("data", [b"", b"[]", b"{}", b"\xff", b'{"type": "MissingReferenceError", "text": ""}'])
def test_what_is_no_error_is_refused(data):
    with pytest.raises(GarbledError):
        read_error(data)


def test_a_head_that_announces_too_much_is_refused_before_memory_is_taken(ends):
    for kind, size in ((Kind.DONE, 1 << 20), (Kind.FRAMES, 1 << 40), (Kind.FAILED, 1 << 30), (200, 1 << 20)):
        ends[0].say(Kind.DONE, [HEAD.pack(kind, 0, 1, size)])
        ends[1].head()
        with pytest.raises(GarbledError):
            ends[1].head()


def test_messages_that_do_not_fit_their_answer_are_refused(ends):
    for packed, number in (([struct.pack("<I", 1 << 30)], 1), (message_parts([b"abc"]), 0), ([b"\0\0\0\0"], 2000)):
        ends[0].say(Kind.MESSAGES, packed, number=number)
        with pytest.raises(GarbledError):
            take_messages(ends[1], ends[1].head(), time.monotonic() + SOON_S)
        while True:  # what is left of it
            ends[1]._socket.settimeout(0.0)
            try:
                ends[1]._socket.recv(1 << 16)
            except BlockingIOError:
                break


def test_frames_that_no_codec_may_give_are_refused(ends):
    """A decoder that was taken over answers what it likes; it must not reach the program that listens."""
    good = b"".join(bytes(part) for part in FrameWriter().parts(frames.scene(1, side=frames.with_positions(1))))
    head = 44
    images = good.index(frames.SENSOR.calibration.table.tobytes()) + frames.SENSOR.calibration.table.nbytes
    azimuth = images + 64 * 6 * 3
    fired = azimuth + 2 * 6 * 2
    bad = {
        "columns": (16, struct.pack("<I", 1 << 30)),
        "packets": (24, struct.pack("<I", 1 << 20)),
        "layouts": (28, struct.pack("<I", 1 << 20)),
        "bytes of positions": (40, struct.pack("<I", 1 << 30)),
        "position packets": (good.index(b"\x28\xb5\x2f\xfd"), b"\0"),
        "flags": (20, struct.pack("<I", 0xFF)),
        "index": (0, struct.pack("<q", -1)),
        "no sensor": (20, struct.pack("<I", 2)),
        "origin": (head + 1, b"\xff"),
        "range step": (head + 3, struct.pack("<d", float("nan"))),
        "azimuth": (azimuth, struct.pack("<H", 36000)),
        "fired": (fired, b"\x02"),
    }
    for what, (at, value) in bad.items():
        wrong = good[:at] + value + good[at + len(value) :]
        ours, theirs = socket.socketpair()
        ours.sendall(wrong)
        ours.close()
        with pytest.raises(GarbledError):
            print(what, FrameReader().take(Channel(theirs), time.monotonic() + SOON_S))
        theirs.close()


def test_the_other_side_that_is_gone_or_says_nothing_ends_every_wait(ends):
    with pytest.raises(TimeoutError):
        ends[1].head(time.monotonic() + 0.05)
    with pytest.raises(TimeoutError):  # nobody reads: the system's buffer is full
        ends[1].say(Kind.FRAMES, [bytes(1 << 22)], end=time.monotonic() + 0.05)
    ends[0].close()
    with pytest.raises(EOFError):
        ends[1].head(time.monotonic() + SOON_S)
    with pytest.raises(EOFError):
        ends[1].say(Kind.DONE, end=time.monotonic() + SOON_S)
