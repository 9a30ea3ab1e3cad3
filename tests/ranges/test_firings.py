"""Firings are counted on across lost packets and frames that were left out: else learned errors go to waste."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from lidarcodec.entropy.predictive_coder import FIRINGS
from lidarcodec.frame import Frame
from lidarcodec.message import SectionType
from lidarcodec.pipeline import StreamDecoder, StreamEncoder
from lidarcodec.ranges.firings import FiringCounter
from lidarcodec.settings import StreamSettings
from lidarcodec.side import SideInfo
from tests.entropy.frames import sensor
from tests.sweeps import examples

HOUR_US = 3_600_000_000


def frame_of(packets: np.ndarray, clock_us: float = 288.0, begin_us: int = 0) -> Frame:
    """A frame of these packets, each counted from the first that was ever sent."""
    columns = 6 * len(packets)
    side = replace(
        SideInfo.regular(len(packets)),
        gps_us=((begin_us + (packets * clock_us).round().astype(np.int64)) % HOUR_US).astype(np.uint32),
    )
    images = np.zeros((64, columns), np.uint16), np.zeros((64, columns), np.uint8), np.zeros((2, columns), np.uint16)
    return Frame(0, int(packets[0]) * 288_000, *images, np.ones((2, columns), np.bool_), sensor(), side)


def counts(frames: list[Frame]) -> list[int]:
    """What a counter says of frame after frame."""
    counter = FiringCounter()
    return [counter.columns_before(frame) for frame in frames]


@pytest.mark.parametrize("clock_us", [288.0, 287.63, 1333.3])
@pytest.mark.parametrize("begin_us", [0, HOUR_US - 60_000])
def test_frames_that_follow_on_each_other_whatever_the_clock(clock_us: float, begin_us: int) -> None:
    widths = [348, 347, 348, 29, 29, 1, 1, 348]
    begins = np.cumsum([0, *widths])
    frames = [frame_of(np.arange(*ends), clock_us, begin_us) for ends in pairwise(begins)]
    assert counts(frames) == [6 * int(begin) for begin in begins[:-1]]


def test_lost_packets_within_a_frame_and_between_two_are_counted() -> None:
    first, second, third = np.arange(348), np.arange(348, 696), np.arange(696, 1044)
    lost = np.delete(first, [0, 17, 100, 101, 347])
    assert counts([frame_of(first), frame_of(np.delete(second, 0)), frame_of(third)]) == [0, 349 * 6, 696 * 6]
    assert counts([frame_of(lost), frame_of(second), frame_of(third)]) == [0, 347 * 6, 695 * 6]


def test_frames_that_were_left_out_are_counted() -> None:
    frames = [frame_of(np.arange(348 * i, 348 * i + 347), 287.63) for i in (0, 1, 5, 6, 40)]
    assert counts(frames) == [6 * 348 * i for i in (0, 1, 5, 6, 40)]


def test_without_a_clock_frames_follow_on_each_other() -> None:
    stopped = [replace(frame_of(np.arange(348 * i, 348 * i + 348), 0.0), index=i) for i in range(3)]
    assert counts(stopped) == [0, 2088, 4176]
    assert counts([replace(frame, side=None) for frame in stopped]) == [0, 2088, 4176]
    assert counts([stopped[0], replace(stopped[1], side=None), stopped[2]]) == [0, 2088, 4176]


@pytest.mark.drawn
@pytest.mark.parametrize("most_us", [1, 2, 600, 2000, 2**32])
def test_any_clock_gives_some_count(most_us: int) -> None:
    rng = np.random.default_rng(1)
    frames = []
    for i in range(examples(300)):
        frame = frame_of(np.arange(348 * i, 348 * i + int(rng.integers(1, 7))))
        gps_us = np.cumsum(rng.integers(0, most_us, frame.side.packets) * rng.choice([1, -1, 1, 1], frame.side.packets))
        frames.append(replace(frame, side=replace(frame.side, gps_us=(gps_us % 2**32).astype(np.uint32))))
    found = counts(frames)
    assert found == sorted(found)


@pytest.mark.parametrize("clock", [lambda n: n // 2 * 576, lambda n: n * 0, lambda n: n % 2 * 4000])
def test_clocks_that_do_not_run_evenly_are_not_believed(clock) -> None:
    begins = [0, 347, 695, 702, 703, 1051]
    frames = []
    for a, b in pairwise(begins):
        frame = frame_of(np.arange(a, b))
        gps_us = clock(np.arange(a, b)).astype(np.uint32)
        frames.append(replace(frame, side=replace(frame.side, gps_us=gps_us)))
    assert counts(frames) == [6 * begin for begin in begins[:-1]]


def test_packets_that_change_places_and_a_clock_that_is_set_are_no_gap() -> None:
    swapped = np.arange(348)
    swapped[[100, 101]] = swapped[[101, 100]]
    later = [frame_of(np.arange(348 * i, 348 * i + 348), begin_us=10**9 * (i > 2)) for i in range(1, 4)]
    assert counts([frame_of(swapped), *later])[:3] == [0, 2088, 4176]
    back = [frame_of(np.arange(348 * i, 348 * i + 348), begin_us=10**9 * (i < 2)) for i in range(4)]
    assert counts(back) == [0, 2088, 4176, 6264]


@pytest.mark.parametrize("packets", [1, 2, 3, 4, 29])
def test_losses_between_and_within_small_slabs_are_counted(packets: int) -> None:
    begins = np.arange(0, 40 * packets, packets)
    sent = [np.arange(begin, begin + packets) for begin in begins]
    for lost in (begins[-3], begins[-3] + packets - 1):
        left = [one[one != lost] for one in sent]
        given = [(begin, one) for begin, one in zip(begins, left, strict=True) if len(one)]
        found = counts([frame_of(one) for _, one in given])
        assert found == [6 * int(one[0]) for _, one in given]


def test_a_frame_that_is_coded_twice_is_counted_once() -> None:
    first, second = frame_of(np.arange(348)), frame_of(np.arange(348, 696)).with_(index=1, stamp_ns=0)
    assert counts([first, first, second, second]) == [0, 0, 2088, 2088]


@pytest.mark.parametrize("codec", ["predictive", "riddle"])
@pytest.mark.parametrize("packets", [40, 348])
def test_messages_say_how_many_columns_were_fired_before_them(codec: str, packets: int) -> None:
    """Slabs of a ninth of a turn, or whole turns; a packet is lost behind the second, and a frame is left out."""
    rng, shift = np.random.default_rng(3), 9 if codec == "riddle" else 0
    begins = [0, packets, 2 * packets + 1, 4 * packets + 1]
    encoder, decoder = StreamEncoder(StreamSettings(codec=codec), stream_id=1), StreamDecoder()
    for index, begin in enumerate(begins):
        frame = frame_of(np.arange(begin, begin + packets))
        ranges = rng.integers(4000, 4100, (64, frame.width)).astype(np.uint16)
        azimuth = np.tile((np.arange(6 * begin, 6 * (begin + packets)) * 17 % 36000).astype(np.uint16), (2, 1))
        frame = frame.with_(index=index, range=ranges, azimuth=azimuth)
        (message,) = encoder.encode(frame)
        coded = message.section(SectionType.RANGE)[2 + shift :]
        assert coded[3] == 6 * begin % FIRINGS  # kind u8, turn u16, firing u8
        (came,) = decoder.decode(message)
        np.testing.assert_array_equal(came.range, ranges)
