"""Firings are counted on across lost packets and frames that were left out: else learned errors go to waste."""

from __future__ import annotations

import doctest
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from lidarcodec.codecs import firings
from lidarcodec.codecs.firings import FiringCounter
from lidarcodec.frame import Frame
from lidarcodec.side import SideInfo
from tests.entropy.frames import sensor

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
    return [counter.before(frame) for frame in frames]


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


def test_any_clock_gives_some_count() -> None:
    rng = np.random.default_rng(1)
    frames = []
    for i in range(40):
        frame = frame_of(np.arange(348 * i, 348 * i + int(rng.integers(1, 40))))
        gps_us = rng.integers(0, 2**32, frame.side.packets).astype(np.uint32)
        frames.append(replace(frame, side=replace(frame.side, gps_us=gps_us)))
    found = counts(frames)
    assert found == sorted(found)


def test_a_frame_that_is_coded_twice_is_counted_once() -> None:
    first, second = frame_of(np.arange(348)), frame_of(np.arange(348, 696))
    assert counts([first, first, second, second]) == [0, 0, 2088, 2088]


def test_the_example_in_the_module_runs() -> None:
    assert doctest.testmod(firings).failed == 0
