"""If these fail, a vehicle does not learn from what it sends, or learning disturbs the stream."""

from __future__ import annotations

import logging
import threading
import time

import pytest

from lidarcodec.apps.once import Once
from lidarcodec.apps.publisher import learning
from lidarcodec.apps.publisher.learning import MOST_FRAMES, SpareLearning
from lidarcodec.network import learner
from lidarcodec.pipeline import StreamEncoder
from lidarcodec.settings import StreamSettings
from tests.apps.in_memory import live, publisher
from tests.transport.test_contract import eventually

NAME = "lidarcodec learning"
BASE = {"codec": "riddle", "max_error_m": 0.0, "intensity": "off", "key_interval": 1000}
ALONE = {"memory": False}
"""The source sends the same turn over and over: only who does not remember has something to learn."""
LEARNING = StreamSettings(**BASE, codec_settings={**ALONE, "learn_ms": 200})


def running() -> bool:
    return any(thread.name == NAME for thread in threading.enumerate())


@pytest.fixture(autouse=True)
def soon(monkeypatch):
    """Looks at what was learned sooner than on a road, and with the priority of the others: this machine is busy."""
    monkeypatch.setattr(learning, "NICENESS", 0)
    monkeypatch.setattr(learner, "CHECK_STEPS", 80)
    monkeypatch.setattr(learner, "HELD_EVERY", 3)
    yield
    assert eventually(lambda: not running())


def test_a_car_learns_and_tells_what_it_brought(network):
    """From the first frame to weights that a receiver uses, switched on over the network while the stream runs."""
    plain = StreamSettings(**BASE, codec_settings=ALONE)
    with live(network, newest=False) as stream, publisher(network, rate=4.0, settings=plain) as car:
        assert stream.next(60)
        assert car.status()["learning"] is None
        assert not running()
        car.change(codec_settings={**ALONE, "learn_ms": 200})
        end = time.monotonic() + 90
        while time.monotonic() < end and not (car.status()["learning"] or {}).get("updates"):
            assert stream.next(60)
        learned = car.status()["learning"]
        assert learned["updates"] >= 1
        assert learned["gain_bits"] > 0
        assert 0 < learned["update_bytes"] < 20_000
        assert learned["seconds"] > 0
        for _ in range(5):
            assert stream.next(60)
        car.change(codec_settings={**ALONE, "learn_ms": 0})
        stopped = car.status()["learning"]
        for _ in range(3):
            assert stream.next(60)
        assert car.status()["learning"]["steps"] <= stopped["steps"] + 1000  # what was under way
        assert stream.summary()["errors"] == {}
        assert car.status()["errors"] == {}


@pytest.mark.sweep
def test_a_late_receiver_of_a_stream_that_learned_joins_at_once(network):
    with live(network) as first, publisher(network, rate=4.0, settings=LEARNING) as car:
        assert first.next(60)
        assert eventually(lambda: (car.status()["learning"] or {}).get("updates", 0) > 0, 90)
        with live(network) as late:
            for _ in range(3):
                assert late.next(60)
            assert late.summary()["errors"] == {}


class Slow(StreamEncoder):
    """An encoder whose training takes its time, and says what it was given."""

    def __init__(self, allowed_ms: float, fault: Exception | None = None) -> None:
        super().__init__(StreamSettings())
        self.allowed_ms, self.fault = allowed_ms, fault
        self.calls: list[float] = []

    @property
    def learn_ms(self) -> float:
        return self.allowed_ms

    def learn(self, steps: int, budget_ms: float | None = None) -> int:
        assert budget_ms is not None
        if self.fault is not None:
            raise self.fault
        began = time.thread_time()
        while 1e3 * (time.thread_time() - began) < budget_ms:
            pass
        self.calls.append(1e3 * (time.thread_time() - began))
        return 1


def test_no_more_processor_time_is_spent_than_frames_allow():
    encoder = Slow(10.0)
    spare = SpareLearning(encoder, Once(logging.getLogger("test")))
    try:
        for _ in range(3):
            spare.encoded()
        assert eventually(lambda: sum(encoder.calls) >= 29)
        time.sleep(0.1)
        assert sum(encoder.calls) < 60  # a slice and what a call takes more than it was given
        before = sum(encoder.calls)
        for _ in range(1000):  # a burst: what is left over is forgotten
            spare.encoded()
        assert eventually(lambda: sum(encoder.calls) - before >= 10 * MOST_FRAMES - 6)
        time.sleep(0.1)
        assert sum(encoder.calls) - before < 10 * (MOST_FRAMES + 10)
    finally:
        spare.close()


def test_a_fault_in_training_ends_the_training_and_nothing_else(caplog):
    once = Once(logging.getLogger("test"))
    spare = SpareLearning(Slow(10.0, RuntimeError("a fault")), once)
    spare.encoded()
    assert eventually(lambda: once.counts["learning errors"] == 1)
    spare.encoded()
    spare.close()
    spare.close()
    assert once.counts["learning errors"] == 1


def test_nothing_is_started_where_nothing_is_asked_for():
    spare = SpareLearning(Slow(0.0), Once(logging.getLogger("test")))
    spare.encoded()
    assert not running()
    spare.close()
    spare.encoded()
