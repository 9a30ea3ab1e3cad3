"""A link that is cut and restored under two processes that stream: quality falls and comes back, frames never lag."""

from __future__ import annotations

import pytest

from benchmarks.adaptive import measured, play
from benchmarks.links import Namespaces, Relayed
from tests.calm import when_calm
from tests.transport.conftest import free_port

pytestmark = pytest.mark.timeout(180)

PARTS = ((12_000.0, 2.0), (2_500.0, 3.5), (12_000.0, 3.0))
"""Kbit/s and seconds: as the 20, 4 and 20 Mbit/s of benchmarks/adaptive.py, for a machine that others use too."""

LATE_S = 0.05
"""A machine that wakes threads later than this encodes and decodes too slowly for these figures."""


@pytest.fixture(params=["relay", pytest.param("namespaces", marks=[pytest.mark.namespaces, pytest.mark.sweep])])
def link(request):
    if request.param == "relay":
        with Relayed(PARTS[0][0], free_port=free_port) as one:
            yield one
        return
    if (why := Namespaces.missing()) is not None:
        pytest.skip(why)
    with Namespaces(PARTS[0][0]) as one:
        yield one


def test_auto_follows_a_link_down_and_up(link):
    when_calm(lambda: follows(link), LATE_S, attempts=2)


def follows(link):
    times, publisher, receiver = play(link, "auto", "sim:city?frames=5", PARTS)
    told = [one for one in publisher.said if one.get("rate")]
    assert {"target_kbps", "limited_by", "auto"} <= set(told[-1]["rate"])

    def targets(begin, end):
        return [one["rate"]["target_kbps"] for one in told if begin <= one["at"] < end]

    fast, slow = targets(times[1] - 1, times[1]), targets(times[2] - 1.5, times[2])
    typical = sorted(slow)[len(slow) // 2]
    assert typical < 0.6 * max(fast)
    assert typical < 1.2 * PARTS[1][0]  # the token bucket of `tc` holds half a frame at that rate
    assert max(targets(times[2], times[3])) > 1.5 * typical
    frames = [one for one in receiver.said if "index" in one]
    narrow = measured(frames, times[1] + 2, times[2])
    assert narrow["fps"] > 5
    assert narrow["latency_p50_ms"] < 400  # at the quality of the wide link a frame would take half a second
    assert publisher.said[-1]["final"]["errors"] == {}


@pytest.mark.sweep
def test_what_was_held_up_by_a_stall_is_left_out_and_the_newest_is_shown():
    """Nothing goes through for four seconds; then a few old frames come at once, and the stream goes on as before."""
    when_calm(goes_on_after_a_stall, LATE_S, attempts=2)


def goes_on_after_a_stall():
    with Relayed(8_000.0, free_port=free_port) as link:
        parts = ((8_000.0, 1.0), (0.0, 4.0), (8_000.0, 2.5))
        times, publisher, receiver = play(link, "auto", "sim:city?frames=5", parts)
    frames = [one for one in receiver.said if "index" in one]
    summary = receiver.said[-1]["summary"]
    assert summary.get("stale", 0) >= 1, "what is too old is counted"
    assert summary["errors"] == {}
    after = [one for one in frames if one["at"] > times[2]]
    assert len(after) > 10, "frames come again"
    assert min(one["latency_ms"] for one in after[-10:]) < 500
    assert publisher.said[-1]["final"]["flight"]["timeouts"] >= 1
