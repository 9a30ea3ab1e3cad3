"""Without these one vehicle ends what a bridge shows of it, or of others, for good."""

from __future__ import annotations

import threading

import pytest

from lidarcodec.apps.publisher.publisher import Publisher
from lidarcodec.bridges.streams import Streams
from lidarcodec.errors import SectionError, TransportError
from tests.apps.streams import Loop
from tests.transport.test_contract import eventually

pytestmark = pytest.mark.timeout(400)


@pytest.mark.parametrize("error", [SectionError("no points in it"), ArithmeticError("too much for it")])
def test_a_frame_that_cannot_be_handed_on_ends_no_stream(network, caplog, error):
    taken = {"car-7": 0, "car-8": 0}

    def take(key, frame):
        taken[key.vehicle] += 1
        if key.vehicle == "car-7" and taken["car-7"] <= 2:
            raise error

    streams = Streams(["car-7/roof", "car-8/roof"], take, transport=network())
    streams.start()
    try:
        with (
            Publisher(Loop(), vehicle="car-7", sensor="roof", rate=5.0, transport=network()),
            Publisher(Loop(), vehicle="car-8", sensor="roof", rate=5.0, transport=network()),
        ):
            assert eventually(lambda: min(taken.values()) >= 4, 120)
        assert not streams.wait(0.01)
        summary = streams.summary()
    finally:
        streams.close()
    assert summary["car-7/roof"]["errors"] == {"frames not handed on": 2}
    assert summary["car-8/roof"]["errors"] == {}
    assert caplog.text.count(str(error)) == 1


def test_a_stream_that_nobody_publishes_is_told_and_waited_for(network, caplog):
    came = threading.Event()
    streams = Streams(["car-7/rof"], lambda key, frame: came.set(), transport=network())
    streams.start()
    try:
        assert eventually(lambda: "nobody publishes car-7/rof yet; waiting" in caplog.text, 60)
        with Publisher(Loop(), vehicle="car-7", sensor="rof", rate=5.0, transport=network()):
            assert came.wait(60)
    finally:
        streams.close()


def test_a_network_that_failed_for_good_ends_the_bridge_and_is_told(network):
    came = threading.Event()

    def take(key, frame):
        came.set()
        raise TransportError("the other network is gone")

    streams = Streams(["car-7/roof"], take, transport=network())
    streams.start()
    try:
        with Publisher(Loop(), vehicle="car-7", sensor="roof", rate=5.0, transport=network()):
            assert came.wait(60)
            with pytest.raises(TransportError, match="is gone"):
                assert eventually(lambda: streams.wait(0.2), 60)
    finally:
        streams.close()
