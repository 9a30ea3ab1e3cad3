"""The link falls from 20 to 3 Mbit/s for ten seconds, with a bitrate that is fixed and with one that adapts."""

from __future__ import annotations

import time
from itertools import pairwise
from typing import Any

from tests.apps.relay import Relay
from tests.faults.outcome import Outcome, await_frames, ends, missing
from tests.transport.conftest import free_port

FAST_KBIT, SLOW_KBIT = 20_000.0, 6_000.0
SLOW_S, SETTLED_S = 10.0, 3.0


def run() -> Outcome:
    fixed, auto = _played({}), _played({"target_kbps": "auto"})
    wrong = [f"errors: {one['errors']}" for one in (fixed, auto) if one["errors"]]
    wrong += ["the bitrate did not follow"] if auto["latency p95 ms"] > fixed["latency p95 ms"] + 200 else []
    return Outcome(
        f"link slowed from {FAST_KBIT / 1e3:g} to {SLOW_KBIT / 1e3:g} Mbit/s",
        auto["longest step s"],
        f"{fixed['missing']} frames lossless, {auto['missing']} with `target_kbps=auto`, which lowers quality instead",
        f"publisher: `replaced`, `rate`; latency at the 95th percentile {fixed['latency p95 ms']:.0f} ms lossless, "
        f"{auto['latency p95 ms']:.0f} ms with auto",
        {"lossless": fixed, "auto": auto},
        wrong,
    )


def _played(settings: dict[str, Any]) -> dict[str, Any]:
    """What was seen while the link was slow, from a while after it had become so."""
    with ends() as start:
        port = free_port()
        car = start("publish", listen=f"tcp/127.0.0.1:{port}", source="sim:city?frames=10", settings=settings)
        relay = Relay(port, kbit=FAST_KBIT)
        try:
            office = start("subscribe", connect=f"tcp/127.0.0.1:{relay.port}")
            await_frames(office, 20)
            relay.kbit = SLOW_KBIT
            slow_s = time.monotonic()
            time.sleep(SLOW_S)
            fast_s = time.monotonic()
            relay.kbit = FAST_KBIT
            await_frames(office, 10)
            car.end()
            office.end()
        finally:
            relay.close()
        summary = office.all("summary")[0]
    slow = [frame for frame in office.frames if slow_s + SETTLED_S < frame["at_s"] < fast_s]
    latencies = sorted(frame["latency_ms"] for frame in slow)
    steps = [b["at_s"] - a["at_s"] for a, b in pairwise(slow)]
    return {
        "frames": len(slow),
        "missing": missing(slow),
        "latency p95 ms": round(latencies[int(0.95 * (len(latencies) - 1))], 1),
        "longest step s": round(max(steps), 2),
        "errors": summary["errors"],
    }
