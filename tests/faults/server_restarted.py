"""The server is killed and started again, and the vehicle restarts while it is away; what an operator set holds."""

from __future__ import annotations

import signal
import tempfile
import time
from pathlib import Path

from tests.faults.outcome import PATIENCE_S, Outcome, await_frames, ends, outage_s
from tests.faults.serving import Server
from tests.transport.conftest import free_port
from tests.transport.test_contract import eventually

STREAM = "/api/v1/streams/vehicle/lidar"
WANTED = {"codec": "zstd", "max_error_m": 0.02}


def run() -> Outcome:
    port = free_port()
    with tempfile.TemporaryDirectory() as folder, ends() as start:
        server = Server(Path(folder), port, free_port())
        try:
            server.start()
            office, car = start("subscribe", loopback_port=port), start("publish", loopback_port=port)
            await_frames(office, 10)
            patched, _ = server.ask(f"{STREAM}/settings", "PATCH", WANTED)
            server.kill()
            killed_s = time.monotonic()
            await_frames(office, 20)
            step_s = outage_s(office, killed_s)
            car.end(signal.SIGKILL)
            again = start("publish", loopback_port=port)
            await_frames(office, 10)
            own = again.status["settings"]["codec"]
            ready_s = server.start()
            begin_s = time.monotonic()
            restored = eventually(lambda: again.status["settings"]["codec"] == WANTED["codec"], PATIENCE_S)
            restored_s = time.monotonic() - begin_s
            listed = server.ask("/api/v1/streams")[1]
            audit = server.ask(f"{STREAM}/audit")[1]
            errors = again.status["errors"]
            office.end()
        finally:
            server.kill()
    summary = office.all("summary")[0]
    wrong = [] if patched == 200 else [f"PATCH answered {patched}"]
    wrong += [] if restored else ["the vehicle did not get its settings back"]
    wrong += [] if listed else ["the stream is not in the list"]
    wrong += [] if audit else ["the audit log is empty"]
    wrong += [f"errors: {one}" for one in (errors, summary["errors"]) if one]
    return Outcome(
        "server killed and started again; the vehicle restarted meanwhile",
        step_s,
        f"REST, and viewers of the server, until it runs again (ready after {ready_s:.1f} s); no frame elsewhere",
        f"vehicle: sends with its own settings ({own}); the server sets what the operator wanted "
        f"{restored_s:.1f} s after it is ready, and has it in the audit log",
        {},
        wrong,
    )
