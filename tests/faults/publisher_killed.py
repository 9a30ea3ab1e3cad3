"""The publisher is killed (SIGKILL) and started again at once, as systemd would."""

from __future__ import annotations

import signal
import time

from tests.faults.outcome import Outcome, await_frames, ends, outage_s, resumed_s
from tests.transport.conftest import free_port


def run() -> Outcome:
    with ends() as start:
        port = free_port()
        office, car = start("subscribe", loopback_port=port), start("publish", loopback_port=port)
        await_frames(office, 10)
        car.end(signal.SIGKILL)
        killed_s = time.monotonic()
        again = start("publish", loopback_port=port)
        await_frames(office, 10)
        up_s = again.all_at("stream")[0]
        office.end()
        summary = office.all("summary")[0]
    after_start_s = resumed_s(office, up_s)
    wrong = [] if summary.get("restarts") == 1 else [f"restarts: {summary.get('restarts')}"]
    wrong += [f"errors: {summary['errors']}"] if summary["errors"] else []
    return Outcome(
        "publisher killed and started again",
        outage_s(office, killed_s),
        "the frames until it runs again",
        "receiver: the stream is not alive, then `restarts` 1; the stream id is another",
        {"note": f"first frame {after_start_s} s after it is up"},
        wrong,
    )
