"""The rates of summaries are means: of totals nobody expects the rate of the last seconds.

`subscribe` ended with "499 frames, 9.3 a second" of a stream that had brought 7.3 a second over 68 s.
"""

from __future__ import annotations

import time

import pytest

import lidarcodec
from lidarcodec.apps.demo.demo import Demo
from lidarcodec.commands.publish.command import summary_line
from lidarcodec.commands.subscribe import line_of
from tests.apps.in_memory import live, publisher
from tests.transport.test_contract import eventually


def test_summaries_of_subscribe_and_of_the_demonstration_have_the_mean(network, monkeypatch):
    frame, stream = next(iter(lidarcodec.read_frames("sim:road?frames=1"))), live(network)
    assert stream.summary()["mean_fps"] is None
    with monkeypatch.context() as patched:
        for at_s in [*range(10), *(10 + tenth / 10 for tenth in range(100))]:  # one a second, then ten
            patched.setattr(time, "monotonic", lambda at_s=at_s: float(at_s))
            stream.stats.decoded(frame, frame.stamp_ns)
        summary, demo = stream.summary(), Demo("sim:road", 1, [])
        assert demo.figures(stream).fps == summary["fps"] == pytest.approx(10, abs=0.1)
        assert demo.figures(stream, whole=True).fps == summary["mean_fps"] == pytest.approx(109 / 19.9, abs=0.01)
    assert "110 frames, 5.5 a second" in line_of(summary, summary["mean_fps"])


def test_a_summary_of_publish_has_the_mean(network):
    begun_s = time.monotonic()
    with publisher(network) as car, live(network):
        assert eventually(lambda: car.status()["frames"] > 2)
        status = car.status()
    taken_s = time.monotonic() - begun_s
    assert status["mean_fps"] >= (status["frames"] - 1) / taken_s - 0.01
    assert f" frames, {status['mean_fps']:.1f} a second, in " in summary_line(status)
