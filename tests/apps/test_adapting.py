"""Between flight and encoder: the encoder hears what the path carries, and the log when it carries nothing."""

from __future__ import annotations

import logging

import pytest

from lidarcodec.api import read_frames
from lidarcodec.apps.publisher.adapting import Adapting
from lidarcodec.apps.publisher.path_times import LIMIT_S
from lidarcodec.pipeline import StreamEncoder
from lidarcodec.ratecontrol.adaptive import SHARE, START_KBPS
from lidarcodec.settings import StreamSettings
from tests.apps.flights import Clock, Path


def path(kbps: float = 8000.0):
    """A flight over a path of so many kbit/s, its adapting, and a function that sends a message of some bytes."""
    clock = Clock()
    flight = Path(clock=clock)
    flight.came("office")
    count = iter(range(1000))

    def send(size: int, *, arrives: bool = True) -> None:
        index = next(count)
        flight.wait(0)
        flight.put(index, size)
        clock.now += size * 8 / (kbps * 1e3) if arrives else LIMIT_S + 0.1
        if arrives:
            flight.told("office", index)
        else:
            assert flight.wait(0)

    return flight, Adapting(flight), send


def target_of(encoder: StreamEncoder) -> float:
    return encoder.rate["target_kbps"]


def test_the_encoder_is_aimed_at_what_the_path_carries():
    _, adapting, send = path(8000.0)
    encoder = StreamEncoder(StreamSettings(target_kbps="auto"))
    adapting.aim(encoder, 0)
    assert target_of(encoder) == START_KBPS
    assert adapting.report()["capacity_kbps"] is None
    for _ in range(10):
        send(40_000)
        adapting.aim(encoder, 0)
    assert abs(target_of(encoder) / (SHARE * 8000) - 1) < 0.02
    assert abs(adapting.report()["capacity_kbps"] / 8000 - 1) < 0.02
    assert encoder.rate["auto"]


def test_the_path_is_known_when_auto_is_switched_on_and_a_number_is_not_touched():
    _, adapting, send = path(8000.0)
    encoder = StreamEncoder(StreamSettings(target_kbps=1500))
    send(40_000)
    adapting.aim(encoder, 0)
    assert target_of(encoder) == 1500
    assert not encoder.rate["auto"]
    encoder.apply(StreamSettings(target_kbps="auto"))
    assert target_of(encoder) == 1500, "until the next frame"
    adapting.aim(encoder, 0)
    assert abs(target_of(encoder) / (SHARE * 8000) - 1) < 0.02
    encoder.apply(StreamSettings(codec="zstd", target_kbps="auto"))
    assert abs(target_of(encoder) / (SHARE * 8000) - 1) < 0.02, "another codec on the same path"


def test_frames_left_out_make_it_take_a_smaller_share():
    _, adapting, send = path(8000.0)
    encoder = StreamEncoder(StreamSettings(target_kbps="auto"))
    for replaced in range(10):
        send(40_000)
        adapting.aim(encoder, replaced)
    assert adapting.report()["share"] < 0.6 * 1.01
    assert target_of(encoder) < 0.5 * 8000


@pytest.mark.parametrize("target", ["auto", 800])
def test_a_path_that_stands_still_is_reported_once_and_so_is_its_end(caplog, target):
    _, adapting, send = path(8000.0)
    encoder = StreamEncoder(StreamSettings(target_kbps=target))
    with caplog.at_level(logging.INFO, "lidarcodec.apps.publisher.adapting"):
        for arrives in (True, False, False, False, True, True):
            send(40_000, arrives=arrives)
            adapting.aim(encoder, 0, automatic=target == "auto")
    assert ["did not arrive" in record.message for record in caplog.records] == [True, False]
    assert ("automatic bitrate" in caplog.text) == (target == "auto"), "a fixed target does not fall"


@pytest.mark.parametrize(("bound", "coarsest"), [(None, 0.3), (0.05, 0.05), (5.0, 0.3)])
def test_a_path_that_is_far_too_narrow_costs_frames_and_not_the_shape_of_things(bound, coarsest):
    """Ranges that are 20 m off show nothing; and a bound that an operator set holds."""
    encoder = StreamEncoder(StreamSettings(target_kbps="auto", max_error_m=bound))
    for frame in read_frames("sim:city?frames=2"):
        encoder.aim(60.0)
        encoder.encode(frame)
    assert encoder.rate["max_error_m"] == pytest.approx(coarsest, abs=0.03)
    assert encoder.rate["step"] == 24
    assert encoder.rate["limited_by"] == "floor"
    assert not encoder.rate["reached"]


class Aim:
    """Takes the bitrate, as an encoder does."""

    target_kbps = START_KBPS

    def aim(self, target_kbps: float) -> None:
        self.target_kbps = target_kbps


@pytest.mark.parametrize(("others", "least_kbps", "most_kbps"), [(("quick",), 12_000.0, 1e9), ((), 0.0, 2_000.0)])
def test_a_viewer_whose_reports_alone_are_late_takes_no_quality_from_others(others, least_kbps, most_kbps):
    """The first that came reports 95 ms late. With nobody else there it is all that is known of the path."""
    clock = Clock()
    flight = Path(clock=clock)
    adapting, encoder = Adapting(flight), Aim()
    for name in ("late", *others):
        flight.came(name)
    for index in range(100):
        adapting.aim(encoder, 0)
        begin = clock.now
        flight.put(index, min(int(encoder.target_kbps * 1e3 / 8 / 10), 160_000))
        for name, after_s in (("quick", 0.005), ("late", 0.095)):
            clock.now = begin + after_s
            if name in ("late", *others):
                flight.told(name, index)
        clock.now = begin + 0.1
    assert flight.following == ("quick" if others else "late")
    assert least_kbps < encoder.target_kbps < most_kbps
