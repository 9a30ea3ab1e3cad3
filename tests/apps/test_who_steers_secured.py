"""Behind mutual TLS and access control, on real links: a viewer that lies about arrivals slows down nobody."""

from __future__ import annotations

import itertools
import threading
import time

import pytest

from lidarcodec.apps.publish import Publisher
from lidarcodec.apps.reports import Arrival, pack_arrival
from lidarcodec.apps.subscribe import LiveStream
from lidarcodec.settings import StreamSettings
from lidarcodec.transport.base import Priority
from lidarcodec.transport.keys import StreamKeys
from tests.apps.streams import Loop
from tests.calm import when_calm
from tests.transport.test_contract import eventually
from tests.transport.test_secured import Secured

pytest.importorskip("cryptography")
pytestmark = pytest.mark.timeout(120)
KEYS = StreamKeys("car-7", "roof")

LATE_S = 0.05
"""Where threads are woken later than this, the one that lies takes the time of all others in its process."""


def frames_of(live, seconds: float) -> int:
    end, count = time.monotonic() + seconds, 0
    while time.monotonic() < end:
        count += live.next(0.2) is not None
    return count


def test_a_viewer_that_reports_what_it_never_received_throttles_nobody(tmp_path_factory):
    when_calm(lambda: throttles_nobody(tmp_path_factory.mktemp("secured")), LATE_S, attempts=2)


def throttles_nobody(folder):
    made, stop = Secured(folder, "certificate"), threading.Event()
    try:
        car, anna, ben = made.open("vehicle-car-7"), made.open("viewer-anna"), made.open("viewer-ben")
        where = {"vehicle": KEYS.vehicle, "sensor": KEYS.sensor, "transport": car, "rate": 10.0}
        with Publisher(Loop(), StreamSettings(codec="zstd"), **where) as publisher:
            anna.token(KEYS.arrived("anna"))
            arrived = anna.sender(KEYS.arrived("anna"), Priority.REAL_TIME)
            assert eventually(lambda: arrived.matching, 20)

            def lie() -> None:
                for number in itertools.count():
                    arrived.put(pack_arrival(Arrival(number % 500, 0, 0, number)))
                    if stop.wait(0.002):
                        return

            liar = threading.Thread(target=lie)
            liar.start()
            with LiveStream("car-7/roof", transport=ben, receiver="ben") as live:
                assert eventually(lambda: live.next(1.0) is not None, 30)
                seen = frames_of(live, 4.0)
                flight = publisher.status()["flight"]
                stop.set()
                liar.join(10.0)
                alone = frames_of(live, 4.0)
        assert flight["following"] == "ben"
        assert flight["receivers"] == ["ben"]
        assert sum(flight["refused"].values()) > 100
        assert seen >= alone / 2, "with the liar followed there was an eighth"
    finally:
        stop.set()
        made.close()
