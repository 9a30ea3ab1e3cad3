"""Behind mutual TLS and access control, on real links: a viewer that lies about arrivals slows down nobody."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import time
from pathlib import Path

import pytest

from lidarcodec.apps.publisher.publisher import Publisher
from lidarcodec.apps.receiver.live_stream import LiveStream
from lidarcodec.settings import StreamSettings
from lidarcodec.transport.keys import StreamKeys
from tests.apps.streams import Loop
from tests.conftest import ROOT
from tests.transport.secured import Secured
from tests.transport.test_contract import eventually

pytest.importorskip("cryptography")
pytestmark = pytest.mark.timeout(120)
KEYS = StreamKeys("car-7", "roof")

ROUNDS = 3
"""Comparisons at most: with the liar followed there was an eighth in each, while a busy machine seldom halves three."""

LIAR = """
import itertools, sys, time
from pathlib import Path
from lidarcodec.apps.reports import Arrival, pack_arrival
from lidarcodec.transport import Endpoints, open_transport
from lidarcodec.transport.base import Priority
from lidarcodec.transport.keys import StreamKeys

keys, anna = StreamKeys("car-7", "roof"), open_transport(Endpoints.of(config=Path(sys.argv[1])))
anna.token(keys.arrived("anna"))
arrived = anna.sender(keys.arrived("anna"), Priority.REAL_TIME)
for number in itertools.count():
    arrived.put(pack_arrival(Arrival(number % 500, 0, 0, number)))
    time.sleep(0.002)
"""


@contextlib.contextmanager
def lying(config: Path):
    """A process that reports, five hundred times a second, what it never received; within the `with`."""
    with subprocess.Popen([sys.executable, "-P", "-c", LIAR, str(config)], cwd=ROOT) as liar:
        try:
            yield
        finally:
            liar.kill()


def frames_of(live, seconds: float) -> int:
    end, count = time.monotonic() + seconds, 0
    while time.monotonic() < end:
        count += live.next(0.2) is not None
    return count


def refusals(publisher) -> int:
    return sum(publisher.status()["flight"]["refused"].values())


def test_a_viewer_that_reports_what_it_never_received_throttles_nobody(tmp_path):
    made = Secured(tmp_path, "certificate")
    try:
        car, ben = made.open("vehicle-car-7"), made.open("viewer-ben")
        where = {"vehicle": KEYS.vehicle, "sensor": KEYS.sensor, "transport": car, "rate": 10.0}
        with (
            Publisher(Loop(), StreamSettings(codec="zstd"), **where) as publisher,
            LiveStream("car-7/roof", transport=ben, receiver="ben") as live,
        ):
            assert eventually(lambda: live.next(1.0) is not None)
            for _ in range(ROUNDS):
                with lying(tmp_path / "viewer-anna.json5"):
                    before = refusals(publisher)
                    assert eventually(lambda before=before: refusals(publisher) > before + 100)
                    seen = frames_of(live, 3.0)
                    flight = publisher.status()["flight"]
                assert (flight["following"], flight["receivers"]) == ("ben", ["ben"])
                alone = frames_of(live, 3.0)
                if seen >= alone / 2:
                    break
            assert seen >= alone / 2, "the liar slows the stream down"
    finally:
        made.close()
