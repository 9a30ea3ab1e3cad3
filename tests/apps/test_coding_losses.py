"""What coding took from a live stream is said at its end, as `encode` says it of a file."""

from __future__ import annotations

import pytest

from lidarcodec.evaluation.coding_losses import CodingLosses
from lidarcodec.settings import StreamSettings
from tests.apps.in_memory import live, publisher
from tests.transport.test_contract import eventually


def told(settings: StreamSettings, **parts: object) -> dict:
    return {"settings": settings.model_dump(), "codec": settings.codec, **parts}


def losses_of(*statuses: dict) -> CodingLosses:
    losses = CodingLosses()
    for status in statuses:
        losses.told(status)
    return losses


def test_a_lossless_stream_has_lost_nothing():
    losses = losses_of(told(StreamSettings()))
    assert losses.text() == ""
    assert losses.values() == {"returns_percent": None, "max_error_m": 0.0, "intensity": ["lossless"]}


@pytest.mark.parametrize(
    ("status", "text"),
    [
        (told(StreamSettings(max_error_m=0.02)), ", ranges off by at most 0.02 m"),
        (told(StreamSettings(intensity="off")), ", intensities left out"),
        (told(StreamSettings(intensity="error=2")), ", intensities off by at most 2"),
        (told(StreamSettings(codec="jpeg")), ", ranges off by no known bound"),
        (told(StreamSettings(base_error_m=0.05)), ", ranges off by at most 0.05 m"),
        (told(StreamSettings(target_kbps=800), rate={"max_error_m": 0.084, "intensity": "levels=3"}),
         ", ranges off by at most 0.084 m, intensities in 3 values"),
    ],
)  # fmt: skip
def test_every_loss_is_named(status, text):
    assert losses_of(status).text() == text


def test_the_worst_that_was_in_force_counts():
    rates = [
        {"max_error_m": error, "intensity": way} for error, way in ((0.01, "lossless"), (0.2, "off"), (0.05, "off"))
    ]
    losses = losses_of(*(told(StreamSettings(target_kbps=800), rate=rate) for rate in rates))
    assert losses.max_error_m == 0.2
    assert losses.intensity == ["lossless", "off"]
    ways = [{"intensity": way} for way in ("levels=10", "off", "levels=2", "lossless")]
    few = losses_of(*(told(StreamSettings(target_kbps=800), rate=rate) for rate in ways))
    assert few.text() == ", intensities left out or in 2 to 10 values"


def test_a_status_that_makes_no_sense_is_no_error():
    for status in ({}, {"settings": 5, "rate": [], "reduction": {"returns": "all"}}, {"codec": "of a newer version"}):
        assert isinstance(losses_of(status).text(), str)


def test_returns_left_out_of_a_stream_are_counted(network):
    losses = CodingLosses()
    with publisher(network, None, StreamSettings(reduction="lattice:4")) as car, live(network) as stream:
        assert eventually(lambda: stream.status is not None)
        for _ in range(3):
            losses.add(stream.next(60), stream.status)
        assert car.settings.reduction == "lattice:4"
    assert losses.returns_percent == pytest.approx(25, abs=1)
    assert losses.text().startswith(", about 25.")
