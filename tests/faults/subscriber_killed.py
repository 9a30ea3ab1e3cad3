"""One of two subscribers is killed (SIGKILL) and started again; the other one watches on."""

from __future__ import annotations

import signal
import time

from tests.faults.outcome import Outcome, await_frames, ends, outage_s
from tests.transport.conftest import free_port


def run() -> Outcome:
    with ends() as start:
        port = free_port()
        car = start("publish", loopback_port=port)
        first = start("subscribe", loopback_port=port)
        await_frames(first, 5)
        other = start("subscribe", loopback_port=port)
        await_frames(other, 10)
        first.end(signal.SIGKILL)  # the one that the publisher follows
        killed_s = time.monotonic()
        again = start("subscribe", loopback_port=port)
        await_frames(again, 10)
        other_s = outage_s(other, killed_s)
        errors = {**car.status["errors"]}
        for one in (again, other):
            one.end()
        summaries = again.all("summary") + other.all("summary")
    joined_s = round(again.frames[0]["since_s"], 2)
    wrong = [f"errors: {one}" for one in (errors, *(summary["errors"] for summary in summaries)) if one]
    return Outcome(
        "subscriber killed and started again",
        other_s,
        "nothing at other receivers; at its own until it runs again",
        "publisher: `receivers` in the status, one key frame more",
        {"note": f"at its own: first frame {joined_s} s after it is up"},
        wrong,
    )
