"""What a vehicle costs a server and a router: processor time and memory by number of vehicles and of streams watched.

    python -m benchmarks.fleet [--vehicles 1,10,30] [--seconds 10] [--json]

Vehicles are `lidarcodec swarm N --shared`, which sends what was encoded once, through a router in a process of its own,
to `lidarcodec serve`. A viewer is a WebSocket that takes every cloud it is given. Processor time is that of the
process, in percent of one processor; all of it runs on this machine, which limits how many streams can be watched. The
cost of a vehicle that encodes is measured by a swarm that does.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import struct
import subprocess
import sys
import tempfile
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from benchmarks.memory import memory_mib
from benchmarks.scenes import FRAMING
from lidarcodec.transport.endpoints import free_port

ROUTER = (
    "import sys, threading\n"
    "from lidarcodec.transport import Endpoints, open_transport\n"
    "with open_transport(Endpoints.of(listen=sys.argv[1], mode='router')):\n"
    "    threading.Event().wait()\n"
)
TICKS = os.sysconf("SC_CLK_TCK")
READY_S, SETTLE_S = 60.0, 4.0
HEAD_FRAME_INDEX = struct.Struct("<Q")


@dataclass
class Cost:
    """Of one set-up: processors in percent of one, memory in MiB, frames a second as a viewer sees them."""

    vehicles: int
    watched: int
    codec: str
    kbps_a_vehicle: float
    server_cpu: float
    server_mib: float
    router_cpu: float
    vehicle_cpu: float | None
    fps_watched: float | None


def cpu_s(process: int) -> float:
    """Processor seconds of a process so far, those of its children that it waited for included."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return sum(int(fields[place]) for place in (11, 12, 13, 14)) / TICKS


@contextlib.contextmanager
def running(*command: str, **options: Any) -> Iterator[subprocess.Popen[bytes]]:
    """A process that is ended afterwards."""
    process = subprocess.Popen(command, **({"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL} | options))
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(20)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


class Viewer:
    """Takes the clouds of one stream and throws them away."""

    def __init__(self, url: str) -> None:
        from websockets.sync.client import connect

        self._socket = connect(url, compression=None, max_size=None, open_timeout=30)
        self.frames = 0
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        from websockets.exceptions import ConnectionClosed

        with contextlib.suppress(ConnectionClosed):
            for data in self._socket:
                if isinstance(data, bytes):
                    self.frames += 1
                    self._socket.send(acknowledgement(data))

    def close(self) -> None:
        self._socket.close()
        self._thread.join(5)


def acknowledgement(data: bytes) -> bytes:
    """What a viewer answers to a cloud: the index of its frame."""
    from clients.python.live_cloud import read_message

    return HEAD_FRAME_INDEX.pack(read_message(data)[0]["frame_index"])


def _json(url: str) -> Any:
    try:
        with urllib.request.urlopen(url, timeout=10) as answer:
            return json.loads(answer.read())
    except (OSError, ValueError, urllib.error.URLError):
        return None


def until(condition: Any, what: str, limit_s: float = READY_S) -> None:
    """Wait until something is so. Raises SystemExit, naming it, after `limit_s`."""
    end = time.monotonic() + limit_s
    while not condition():
        if time.monotonic() > end:
            raise SystemExit(f"{what} did not happen within {limit_s:g} s")
        time.sleep(0.05)


def measure(vehicles: int, watched: int, codec: str, source: str, seconds: float, *, shared: bool = True) -> Cost:
    """The cost of so many vehicles, of which so many streams are watched by one viewer each."""
    endpoint, port = f"tcp/127.0.0.1:{free_port()}", free_port()
    lidarcodec = (sys.executable, "-m", "lidarcodec.cli")
    swarm = (*lidarcodec, "swarm", str(vehicles), source, "--codec", codec, "--connect", endpoint)
    swarm += ("--frames", "20", "--set", f"framing={FRAMING}")
    swarm += ("--shared",) if shared else ("--processes", "1")
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        database = {"LIDARCODEC_DATABASE_URL": f"sqlite:///{folder}/server.db"}
        router = stack.enter_context(running(sys.executable, "-c", ROUTER, endpoint))
        serve = (*lidarcodec, "serve", "--port", str(port), "--connect", endpoint)
        server = stack.enter_context(running(*serve, env=os.environ | database))
        senders = stack.enter_context(running(*swarm))
        url = f"127.0.0.1:{port}/api/v1/streams"
        until(lambda: len([one for one in alive(f"http://{url}") if one]) == vehicles, "all vehicles in the list")
        viewers = [Viewer(f"ws://{url}/car-{number:03d}/lidar/cloud") for number in range(1, watched + 1)]
        for viewer in viewers:
            stack.callback(viewer.close)
        time.sleep(SETTLE_S)
        before, begin = [cpu_s(one.pid) for one in (server, router, senders)], time.monotonic()
        frames = sum(viewer.frames for viewer in viewers)
        sent = _sent(f"http://{url}")
        time.sleep(seconds)
        took = time.monotonic() - begin
        used = [100 * (cpu_s(one.pid) - was) / took for one, was in zip((server, router, senders), before, strict=True)]
        seen = sum(viewer.frames for viewer in viewers) - frames
        kbps = (_sent(f"http://{url}") - sent) * 8 / 1e3 / took / vehicles
        return Cost(
            vehicles,
            watched,
            codec,
            round(kbps),
            round(used[0], 1),
            memory_mib(server.pid)[0],
            round(used[1], 1),
            None if shared else round(used[2] / vehicles, 1),
            round(seen / took / watched, 1) if watched else None,
        )


def alive(url: str) -> list[bool]:
    """Whether each stream of the list is alive and has told its status."""
    return [stream["alive"] and stream["status"] is not None for stream in _json(url) or []]


def _sent(url: str) -> int:
    return sum(stream["status"]["bytes"] for stream in _json(url) or [] if stream["status"])


def table(costs: list[Cost]) -> str:
    """Costs as a table of a page."""
    lines = [
        "| vehicles | watched | codec | kbit/s each | server, % of a processor | server, MiB | router, % "
        "| a vehicle, % | frames/s seen |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for cost in costs:
        values = ["-" if value is None else str(value) for value in asdict(cost).values()]
        lines.append(f"| {' | '.join(values)} |")
    return "\n".join(lines)


def main() -> int:
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.fleet", description=__doc__)
    parser.add_argument("--vehicles", default="1,10,30")
    parser.add_argument("--watched", default="0,1,5", help="viewers, at most one a stream")
    parser.add_argument("--codec", default="pcodec")
    parser.add_argument("--source", default="sim:city")
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--json", action="store_true")
    chosen = parser.parse_args()
    watched = [int(text) for text in chosen.watched.split(",")]
    costs = []
    for vehicles in map(int, chosen.vehicles.split(",")):
        for number in watched:
            if number <= vehicles:
                costs.append(measure(vehicles, number, chosen.codec, chosen.source, chosen.seconds))
                print(costs[-1], file=sys.stderr, flush=True)
    costs.append(measure(2, 2, chosen.codec, chosen.source, chosen.seconds, shared=False))  # who is watched encodes
    print(json.dumps([asdict(cost) for cost in costs]) if chosen.json else table(costs))
    return 0


if __name__ == "__main__":
    sys.exit(main())
