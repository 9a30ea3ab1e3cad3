"""The live path as it is used: publisher and subscriber as processes, over Zenoh, killed and throttled."""

from __future__ import annotations

import hashlib
import json
import signal
import subprocess
import sys
import threading
import time

import pytest

from tests import forks
from tests.apps.relay import Relay
from tests.apps.streams import Loop
from tests.calm import Calm
from tests.conftest import ROOT
from tests.sweeps import sampled
from tests.transport.conftest import free_port
from tests.transport.test_contract import eventually

pytestmark = pytest.mark.timeout(300)

LATE_S = 0.03
"""A machine that wakes threads later than this encodes and decodes too slowly for what is said of times here."""


class End:
    """A process of tests.apps.runner, and what it has said."""

    def __init__(self, role: str, **options) -> None:
        command = [sys.executable, "-m", "tests.apps.runner", role, json.dumps(options)]
        self._follow(forks.Process(command, cwd=ROOT, stdout=subprocess.PIPE, text=True))

    def _follow(self, process: subprocess.Popen) -> None:
        """Read what a process says."""
        self.process = process
        self.said: list[dict] = []
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        for line in self.process.stdout:
            if line.startswith("{"):  # the network library also logs here
                self.said.append(json.loads(line) | {"at_s": time.monotonic()})

    def all(self, word: str) -> list:
        return [one[word] for one in list(self.said) if word in one]

    def all_at(self, word: str) -> list[float]:
        """When the lines with a word came, on the monotonic clock."""
        return [one["at_s"] for one in list(self.said) if word in one]

    @property
    def frames(self) -> list[dict]:
        return [one for one in list(self.said) if "index" in one]

    @property
    def status(self) -> dict:
        return (self.all("status") or [{}])[-1]

    def end(self, number: int = signal.SIGTERM) -> None:
        """Send a signal and wait."""
        if self.process.poll() is None:
            self.process.send_signal(number)
        self.process.wait(60)
        self._thread.join(60)
        self.process.stdout.close()


@pytest.fixture
def ends():
    """Function that starts an end; all are killed after the test."""
    started = []

    def start(role: str, **options) -> End:
        started.append(End(role, **options))
        return started[-1]

    yield start
    for one in started:
        if one.process.poll() is None:
            one.end(signal.SIGKILL)


def test_every_packet_goes_from_one_process_to_the_other(ends):
    port = free_port()
    office = ends("subscribe", loopback_port=port, newest=False, until_end=True)
    car = ends("publish", loopback_port=port, frames=12, rate="max")
    assert office.process.wait(60) == 0
    assert car.process.wait(60) == 0
    office.end()
    payloads = Loop(12).payloads()
    for number, frame in enumerate(office.frames):
        assert frame["index"] == number
        wanted = payloads[348 * number : 348 * number + 348]
        assert frame["sha256"] == hashlib.sha256(b"".join(wanted)).hexdigest()
    assert len(office.frames) == 12
    assert office.all("summary")[0]["errors"] == {}


def test_a_late_subscriber_sees_a_frame_within_a_second(ends):
    port = free_port()
    car = ends("publish", loopback_port=port, settings={"key_interval": 100_000})
    assert eventually(lambda: car.status.get("assembled", 0) > 10)
    first = ends("subscribe", loopback_port=port)
    assert eventually(lambda: len(first.frames) > 8)
    late = ends("subscribe", loopback_port=port)
    assert eventually(lambda: late.frames)
    assert late.frames[0]["since_s"] < 10  # the next key frame by itself would come in three hours
    time.sleep(0.3)
    first.end()
    late.end()
    assert first.all("summary")[0]["errors"] == late.all("summary")[0]["errors"] == {}


@pytest.mark.parametrize("first", sampled(["publish", "subscribe"], ["subscribe"]))
def test_each_side_picks_up_after_the_other_was_killed(ends, first):
    """`first` keeps the meeting point, so each side is once the one whose death has to be survived there."""
    port = free_port()
    options = {"loopback_port": port}
    second = "subscribe" if first == "publish" else "publish"
    sides = {first: ends(first, **options)}
    assert eventually(lambda: sides[first].said)
    sides[second] = ends(second, **options)
    for killed in (first, second):
        assert eventually(lambda: len(sides["subscribe"].frames) > 3)
        sides[killed].end(signal.SIGKILL)
        seen = 0 if killed == "subscribe" else len(sides["subscribe"].frames)
        sides[killed] = ends(killed, **options)
        assert eventually(lambda seen=seen: len(sides["subscribe"].frames) > seen + 3)
        came_s = sides["subscribe"].frames[seen + 3]["at_s"]
        assert came_s - sides[killed].said[0]["at_s"] < 10, "since it was there again"
    stream = sides["publish"].all("stream")[0]
    assert sides["subscribe"].frames[-1]["stream"] == stream
    for side in sides.values():
        side.end()
        assert side.process.returncode == 0


def test_a_signal_ends_either_side_cleanly_and_quickly(ends):
    port = free_port()
    office, car = ends("subscribe", loopback_port=port), ends("publish", loopback_port=port)
    assert eventually(lambda: office.frames)
    for one in (car, office):
        begin = time.monotonic()
        one.end()
        assert one.process.returncode == 0
        assert time.monotonic() - begin < 20
    assert car.status["ended"]
    assert office.all("summary")


@pytest.mark.parametrize(("kbit", "delay_s"), sampled([(4000, 0.0), (8000, 0.05)], [(8000, 0.05)]))
def test_a_narrow_path_costs_frames_and_not_latency_and_both_sides_count_them(ends, kbit, delay_s):
    """A stream of about 10 Mbit/s through a relay: the newest frames arrive, none is older than a few messages take."""
    port = free_port()
    car = ends("publish", listen=f"tcp/127.0.0.1:{port}", whole=True)
    assert eventually(lambda: car.said)
    relay = Relay(port, kbit=kbit, delay_s=delay_s)
    try:
        office = ends("subscribe", connect=f"tcp/127.0.0.1:{relay.port}")
        with Calm() as calm:
            assert eventually(lambda: len(office.frames) > 12 and car.status["replaced"] > 3)
        status = car.status
        office.end()
        car.end()
    finally:
        relay.close()
    summary = office.all("summary")[0]
    size = status["bytes"] / status["messages"]
    one_message_ms = 1e3 * (size * 8 / (kbit * 1e3) + delay_s)
    assert summary["missing"] > 3
    assert summary["errors"] == {}
    assert summary["messages"] > 0.6 * status["messages"] or calm.late_s > LATE_S
    assert summary["latency_ms"]["p50"] < 2.5 * one_message_ms + 400 or calm.late_s > LATE_S
    assert summary["latency_ms"]["p99"] < 4 * one_message_ms + 1000 or calm.late_s > LATE_S
    if delay_s:
        assert status["flight"]["window"] > 1


def test_a_receiver_that_hangs_does_not_hold_up_the_other(ends):
    port = free_port()
    car = ends("publish", loopback_port=port)
    hangs = ends("subscribe", loopback_port=port)
    assert eventually(lambda: len(hangs.frames) > 2)
    works = ends("subscribe", loopback_port=port)
    assert eventually(lambda: len(works.frames) > 16)
    usual_s = works.frames[16]["at_s"] - works.frames[1]["at_s"]
    hangs.process.send_signal(signal.SIGSTOP)
    try:
        time.sleep(1.5)
        before = len(works.frames)
        # whoever is held up by a receiver that hangs gets one message a second
        assert eventually(lambda: len(works.frames) - before > 14, max(8.0, 4.0 * usual_s))
    finally:
        hangs.process.send_signal(signal.SIGCONT)
    before = len(hangs.frames)
    assert eventually(lambda: len(hangs.frames) > before + 5)
    assert car.status["errors"] == {}
