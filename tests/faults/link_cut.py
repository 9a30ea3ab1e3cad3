"""Nothing passes the link for ten seconds; nobody is told, as when a vehicle is in a tunnel."""

from __future__ import annotations

import time

from tests.apps.relay import Relay
from tests.faults.outcome import Outcome, await_frames, ends, missing, outage_s, resumed_s
from tests.transport.conftest import free_port

KBIT, CUT_S = 20_000.0, 10.0


def run() -> Outcome:
    with ends() as start:
        port = free_port()
        car = start("publish", listen=f"tcp/127.0.0.1:{port}")
        relay = Relay(port, kbit=KBIT)
        try:
            office = start("subscribe", connect=f"tcp/127.0.0.1:{relay.port}")
            await_frames(office, 20)
            relay.kbit = 0.0
            cut_s = time.monotonic()
            time.sleep(CUT_S)
            relay.kbit = KBIT
            back_s = time.monotonic()
            await_frames(office, 20)
            time.sleep(1.0)
            status = car.status
            car.end()
            time.sleep(0.5)
            office.end()
        finally:
            relay.close()
        summary = office.all("summary")[0]
    lost, stale = missing(office.frames), summary.get("stale", 0)
    late = [frame for frame in office.frames if frame["at_s"] > back_s + 2.0 and frame["latency_ms"] > 1000.0]
    wrong = [f"errors: {summary['errors']}"] if summary["errors"] else []
    wrong += [f"{len(late)} frames older than a second, two seconds after the link was back"] if late else []
    return Outcome(
        f"link cut for {CUT_S:g} s",
        outage_s(office, cut_s),
        f"{lost} frames",
        f"publisher: {status['replaced']} `replaced`, {status['flight']['timeouts']} `timeouts`; receiver: "
        f"{lost} `missing`, {stale} `stale`",
        {"note": f"first frame {resumed_s(office, back_s)} s after the link is back"},
        wrong,
    )
