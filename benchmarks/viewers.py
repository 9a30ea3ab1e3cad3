"""What viewers cost the server: processor time a frame, frames that each gets, and how old they are then.

python -m benchmarks.viewers [--source sim:city] [--seconds 10] [--viewers 1,10,50] [--codec pcodec] [--sockets frames]

Three processes: a vehicle at 10 Hz, the server, and the viewers, over loopback. Viewers acknowledge each frame as soon
as it is there and look at nothing but its header. Processor time is that of the server's process alone, all of it, by
the frames that were seen in that time: on a busy machine the vehicle sends fewer.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import os
import signal
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import httpx
import uvicorn
from websockets.asyncio.client import connect

from benchmarks.scenes import FRAMING
from lidarcodec import Publisher, StreamSettings, open_source
from lidarcodec.apps.publisher.source import NOMINAL_HZ
from lidarcodec.sources.pacing import PacedSource
from lidarcodec.transport import Endpoints
from lidarcodec.transport.endpoints import free_port
from lidarcodec_server.app import create_app
from lidarcodec_server.config import ServerConfig
from lidarcodec_server.live.protocol import ViewerProtocol

STREAM = "vehicle/lidar"
SOCKETS = {
    "nobody": "",
    "cloud": f"{STREAM}/cloud",
    "cloud of 20000 points": f"{STREAM}/cloud?max_points=20000",
    "cloud as range image": f"{STREAM}/cloud?form=range",
    "frames": f"{STREAM}/frames",
}
SETTLE_S = 3.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--source", default="sim:city?packets=34800")
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--viewers", default="1,10,50")
    parser.add_argument("--codec", default="pcodec")
    parser.add_argument("--sockets", default=",".join(SOCKETS), help="those of the table's first column, with commas")
    parser.add_argument("--serve", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--publish", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.serve:
        serve(options.serve)
        return
    if options.publish:
        publish(options.source, options.codec)
        return
    port, meeting = free_port(), free_port()
    here = dict(os.environ, LIDARCODEC_LOOPBACK_PORT=str(meeting))
    server = [sys.executable, "-m", "benchmarks.viewers", "--serve", str(port)]
    vehicle = [sys.executable, "-m", "benchmarks.viewers", "--publish", "--source", options.source]
    vehicle += ["--codec", options.codec]
    print("| socket | viewers | server, ms a frame | frames/s a viewer | MB/s in all | age p50 / p99 ms |")
    print("|---|---|---|---|---|---|", flush=True)
    with _process(server, here) as pid, _process(vehicle, here):
        _wait(port)
        for name, path in ((name, SOCKETS[name]) for name in options.sockets.split(",")):
            for viewers in [0] if not path else [int(one) for one in options.viewers.split(",")]:
                print(asyncio.run(measure(port, pid, name, path, viewers, options.seconds)), flush=True)


def serve(port: int) -> None:
    """The server, in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        config = ServerConfig(
            port=port,
            database_url=f"sqlite:///{folder}/server.db",
            recordings=Path(folder) / "recordings",
            max_viewers=1000,
            max_viewers_a_client=1000,
            endpoints=Endpoints(),
        )
        uvicorn.run(
            create_app(config), port=port, ws=ViewerProtocol, ws_per_message_deflate=False, log_level="critical"
        )


def publish(spec: str, codec: str) -> None:
    """The vehicle, in a process of its own: over and over, at 10 Hz."""
    with open_source(spec) as source:
        Publisher(
            PacedSource(source, speed=10.0 / NOMINAL_HZ, loop=True, restamp=True),
            StreamSettings(codec=codec, framing=FRAMING),
        ).run()


async def measure(port: int, pid: int, name: str, path: str, viewers: int, seconds: float) -> str:
    """A row of the table."""
    ages: list[float] = []
    frames: set[int] = set()
    got = 0
    counting = asyncio.Event()
    size = 0

    async def look() -> None:
        nonlocal got, size
        url = f"ws://127.0.0.1:{port}/api/v1/streams/{path}"
        async with connect(url, compression=None, max_size=None) as one:
            async for message in one:
                if isinstance(message, bytes):
                    await one.send("ack")
                    if counting.is_set():
                        got += 1
                        size += len(message)
                        (stamp_ns,) = struct.unpack_from("<q", message, 24)  # there in both kinds
                        frames.add(stamp_ns)
                        ages.append((time.time_ns() - stamp_ns) / 1e6 - 100.0)

    tasks = [asyncio.create_task(look()) for _ in range(viewers)]
    await asyncio.sleep(SETTLE_S)
    begin, used = time.monotonic(), _processor_s(pid)
    counting.set()
    await asyncio.sleep(seconds)
    counting.clear()
    took, used = time.monotonic() - begin, _processor_s(pid) - used
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
    await asyncio.sleep(SETTLE_S)
    ages.sort()
    age = f"{ages[len(ages) // 2]:.0f} / {ages[int(0.99 * len(ages))]:.0f}" if ages else "-"
    rate = f"{got / viewers / took:.1f}" if viewers else "-"
    seen = len(frames) or 10.0 * took
    return f"| {name} | {viewers} | {1e3 * used / seen:.1f} | {rate} | {size / took / 1e6:.1f} | {age} |"


def _processor_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _wait(port: int) -> None:
    for _ in range(300):
        with contextlib.suppress(httpx.HTTPError):
            known = httpx.get(f"http://127.0.0.1:{port}/api/v1/streams", timeout=5).json()
            if any(one["alive"] for one in known):
                return
        time.sleep(0.1)
    raise SystemExit("the vehicle did not come")


@contextlib.contextmanager
def _process(command: list[str], environment: dict[str, str]) -> Iterator[int]:
    with subprocess.Popen(command, env=environment, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL) as one:
        try:
            yield one.pid
        finally:
            one.send_signal(signal.SIGTERM)
            try:
                one.wait(10)
            except subprocess.TimeoutExpired:
                one.kill()


if __name__ == "__main__":
    main()
