"""Two routers between vehicle and receiver; the vehicle's is killed (SIGKILL) and back after two seconds."""

from __future__ import annotations

import time

from tests.faults.outcome import Outcome, await_frames, ends, missing, outage_s, resumed_s
from tests.transport.conftest import free_port
from tests.transport.router import Router

AWAY_S = 2.0


def run() -> Outcome:
    near, far = f"tcp/127.0.0.1:{free_port()}", f"tcp/127.0.0.1:{free_port()}"
    routers = [Router(listen=near), Router(listen=far, connect=near)]
    try:
        with ends() as start:
            office, car = start("subscribe", connect=far), start("publish", connect=near)
            await_frames(office, 10)
            routers[0].kill()
            killed_s = time.monotonic()
            time.sleep(AWAY_S)
            routers[0] = Router(listen=near)
            back_s = time.monotonic()
            await_frames(office, 10)
            car.end()
            time.sleep(0.5)
            office.end()
            summary, status = office.all("summary")[0], car.status
    finally:
        for router in routers:
            router.kill()
    lost = missing(office.frames)
    explained = status["replaced"] + status["no_receiver"]
    wrong = [f"errors: {summary['errors']}"] if summary["errors"] else []
    wrong += [f"{lost} frames missing, {explained} explained"] if lost > explained + 3 else []
    wrong += ["the stream was restarted"] if summary.get("restarts") else []
    return Outcome(
        f"router killed, back after {AWAY_S:g} s (two hops)",
        outage_s(office, killed_s),
        f"{lost} frames, while there was no way",
        f"publisher: {explained} `no_receiver` and `replaced`; receiver: {summary.get('missing', 0)} `missing`",
        {"note": f"first frame {resumed_s(office, back_s)} s after the router is back"},
        wrong,
    )
