"""A clock is set an hour ahead, then two hours back, in mid-stream: once the vehicle's, once the receiver's.

The clock is one that is handed in; only what is said of time may change.
"""

from __future__ import annotations

import time
from typing import Any

from lidarcodec.apps.clocks import Clock
from lidarcodec.apps.publisher.publisher import Publisher
from lidarcodec.apps.receiver.live_stream import LiveStream
from lidarcodec.transport import Endpoints
from tests.apps.streams import Loop
from tests.faults.outcome import Outcome
from tests.transport.conftest import free_port

JUMPS_S = (3600, -7200)
EACH_S = 5.0


class Host:
    """A machine whose wall clock can be set."""

    def __init__(self) -> None:
        self.ahead_ns = 0
        self.clock = Clock(lambda: time.time_ns() + self.ahead_ns)


def run() -> Outcome:
    seen = [_played(who) for who in ("vehicle", "receiver")]
    wrong = [f"{one['who']}: {one['errors']}" for one in seen if one["errors"]]
    wrong += [f"{one['who']}: no jump was noticed" for one in seen if not one["jumps"]]
    wrong += [f"{one['who']}: latency {one['latency p99 ms']} ms" for one in seen if one["latency p99 ms"] > 5000]
    return Outcome(
        "clock jumped, an hour ahead and two back, of vehicle or receiver",
        max(one["outage s"] for one in seen),
        f"nothing; {sum(one['stale'] for one in seen)} frames were taken for stale",
        f"receiver: `clock.jumps`, {sum(one['clocks_apart'] for one in seen)} frames of unknown latency "
        f"(`clocks_apart`), the rest right again",
        {one.pop("who"): one for one in seen},
        wrong,
    )


def _played(who: str) -> dict[str, Any]:
    hosts = {"vehicle": Host(), "receiver": Host()}
    endpoints = Endpoints(loopback_port=free_port())
    steps: list[float] = []
    with (
        Publisher(Loop(), endpoints=endpoints, clock=hosts["vehicle"].clock) as car,
        LiveStream("vehicle/lidar", endpoints=endpoints, clock=hosts["receiver"].clock) as live,
    ):
        while live.summary()["clock"]["state"] == "unknown" or live.stats.counts["frames"] < 10:
            live.next(1.0)
        for by_s in JUMPS_S:
            hosts[who].ahead_ns += by_s * 10**9
            last = time.monotonic()
            end = last + EACH_S
            while time.monotonic() < end:
                if live.next(0.5) is not None:
                    steps.append(time.monotonic() - last)
                    last = time.monotonic()
        summary, errors = live.summary(), car.status()["errors"]
    return {
        "who": who,
        "outage s": round(max(steps), 2),
        "jumps": summary["clock"]["jumps"],
        "clocks_apart": summary.get("clocks_apart", 0),
        "stale": summary.get("stale", 0),
        "latency p99 ms": summary["latency_ms"]["p99"],
        "errors": {**summary["errors"], **errors},
    }
