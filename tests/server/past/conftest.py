"""A server that keeps clips, and a vehicle that kept the past."""

from __future__ import annotations

import pytest

from lidarcodec.apps.past.keeper import Keep
from lidarcodec.apps.publisher.publisher import Publisher
from tests.apps.past.kept_drive import SMALL, ring
from tests.apps.streams import Loop


@pytest.fixture
def config(config, tmp_path):
    return config.model_copy(update={"past": tmp_path / "past"})


@pytest.fixture
def keeping(network, tmp_path):
    """Function that starts car-7/roof with a ring in which 60 frames were kept; it is stopped after the test.

    write: what was kept instead
    """
    started = []

    def start(write=lambda folder: ring(folder, 0, 60)):
        if not started:
            write(tmp_path / "ring")
        car = Publisher(
            Loop(),
            vehicle="car-7",
            sensor="roof",
            keep=Keep(tmp_path / "ring", 8 * SMALL),
            transport=network.transport(),
        )
        started.append(car.start())
        return car

    yield start
    for car in started:
        car.stop()
