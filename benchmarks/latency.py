"""End-to-end latency over loopback, two processes: host time of a frame's last packet to the decoded frame.

    python -m benchmarks.latency [--source sim:city] [--rate 10] [--seconds 30] [--codec CODEC|all] [--set KEY=VALUE]...

Prints one JSON object: latency, and what it is made of, in milliseconds (p50 and p99 over the newest 600 frames). With
`--codec all` a table: every codec with its own default settings. A file is played over and over.
"""

from __future__ import annotations

import argparse
import json
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import lidarcodec
from benchmarks.link_ends import looped
from benchmarks.scenes import FRAMING
from lidarcodec.codecs import table
from lidarcodec.commands.settings import one_setting
from lidarcodec.sources import open_source
from lidarcodec.transport.endpoints import free_port

ROOT = Path(__file__).resolve().parent.parent
WARM_UP = 5
"""First frames that are left out: imports and first uses."""
FIRST_FRAME_S = 60.0
STREAM = "latency/lidar"


def publish(options: argparse.Namespace) -> None:
    """The publisher's process; its last line is its status."""
    simulated = options.source.startswith(("sim:", "udp:"))
    framing = [] if any(pair.startswith("framing=") for pair in options.set) else [f"framing={FRAMING}"]
    with open_source(options.source) if simulated else looped(options.source) as source:
        publisher = lidarcodec.Publisher(
            source,
            one_setting(options.codec, [*framing, *options.set]),
            vehicle="latency",
            rate=options.rate,
            endpoints=lidarcodec.Endpoints(loopback_port=options.port),
        )
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: publisher.interrupt())
        publisher.run()
    print(json.dumps(publisher.status()), flush=True)


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Latency of a publisher's process, seen from this one."""
    command = [sys.executable, "-m", "benchmarks.latency", "--publish", "--port", str(options.port)]
    for name in ("source", "rate", "codec"):
        command += [f"--{name}", str(getattr(options, name))]
    for pair in options.set:
        command += ["--set", pair]
    values: list[float] = []
    with (
        lidarcodec.subscribe(STREAM, loopback_port=options.port) as live,
        subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as publisher,
    ):
        first = live.next(FIRST_FRAME_S)
        end = time.monotonic() + options.seconds
        while first is not None and time.monotonic() < end and live.next(5.0) is not None:
            pass
        values = live.stats.latency_ms.recent()[WARM_UP:]
        received = live.summary()
        publisher.send_signal(signal.SIGTERM)
        output = publisher.communicate(timeout=30)[0]
    sent = json.loads(output.splitlines()[-1])
    values.sort()
    return {
        "source": options.source,
        "rate": options.rate,
        "settings": sent["settings"],
        "frames": len(values),
        "latency_ms": None if not values else {
            "p50": round(values[len(values) // 2], 2),
            "p99": round(values[min(len(values) - 1, int(0.99 * len(values)))], 2),
            "max": round(values[-1], 2),
        },
        "encode_ms": {name: sent["encode_ms"][name] for name in ("p50", "p99")},
        "put_ms": {name: sent["put_ms"][name] for name in ("p50", "p99")},
        "arrive_ms": {name: sent["flight"]["arrive_ms"][name] for name in ("p50", "p99")},
        "decode_ms": {name: received["decode_ms"][name] for name in ("p50", "p99")},
        "rtt_ms": received["rtt_ms"],
        "kbps": sent["kbps"],
        "replaced": sent["replaced"],
        "missing": received.get("missing", 0),
        "errors": received["errors"] | sent["errors"],
    }  # fmt: skip


def row(codec: str, found: dict[str, Any]) -> str:
    """A line of the table of all codecs."""
    latency, parts = found["latency_ms"] or {}, ("encode_ms", "arrive_ms", "decode_ms")
    spent = " | ".join(f"{found[part]['p50']:.1f}" for part in parts)
    return (
        f"| `{codec}` | {latency.get('p50')} | {latency.get('p99')} | {spent} "
        f"| {found['kbps'] / 1e3:.1f} | {found['replaced']} |"
    )


def every_codec(options: argparse.Namespace) -> bool:
    """Measure each codec and print a table; whether all of them gave frames."""
    print(
        "| codec | p50 ms | p99 ms | encode | arrive | decode | Mbit/s | replaced |\n|---|---|---|---|---|---|---|---|"
    )
    good = True
    for codec in table.names():
        found = measure(argparse.Namespace(**vars(options) | {"codec": codec, "port": free_port()}))
        good &= bool(found["frames"]) and not found["errors"]
        print(row(codec, found), flush=True)
    return good


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.latency", description=__doc__.splitlines()[0])
    parser.add_argument("--source", default="sim:city")
    parser.add_argument("--rate", type=float, default=10.0)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--codec", default="pcodec")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--port", type=int, default=0, help=argparse.SUPPRESS)
    parser.add_argument("--publish", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.publish:
        publish(options)
        return 0
    if options.codec == "all":
        return 0 if every_codec(options) else 1
    options.port = options.port or free_port()
    found = measure(options)
    print(json.dumps(found, indent=2))
    return 0 if found["frames"] else 1


if __name__ == "__main__":
    sys.exit(main())
