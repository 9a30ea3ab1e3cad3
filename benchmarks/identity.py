"""Captures through the whole path, packet for packet: publish, Zenoh, subscribe, decode, and out again over UDP.

    python -m benchmarks.identity [--codec pcodec] [--calibration FILE] CAPTURE...

One line a capture: packets sent, packets decoded and received over UDP in their order, and whether all payloads are
equal. The publisher is a process of its own; exit code 1 when a payload differs or is missing. UDP goes at the sensor's
own pace, so a drive takes as long as it was.
"""

from __future__ import annotations

import argparse
import hashlib
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import NamedTuple

import lidarcodec
from benchmarks.scenes import FRAMING
from lidarcodec.packet import Packet
from lidarcodec.transport.endpoints import free_port

LAST_PACKETS_S = 2.0
FIRST_FRAME_S = 60.0


class Run(NamedTuple):
    """Number of packets and digest of their payloads in order."""

    packets: int
    digest: str


def run_of(packets: list[Packet]) -> Run:
    """What a list of packets comes to."""
    return Run(len(packets), hashlib.sha256(b"".join(p.payload for p in packets)).hexdigest()[:16])


def received_over_udp(port: int, into: list[Packet], ready: threading.Event, stop: threading.Event) -> None:
    """Collect packets as any Velodyne driver would, until told to stop."""
    with lidarcodec.open_source(f"udp://127.0.0.1:{port}") as source:

        def close() -> None:
            stop.wait()
            source.close()

        threading.Thread(target=close, daemon=True).start()
        ready.set()
        into.extend(source.packets())


def through(capture: Path, codec: str, calibration: Path | None, udp: bool) -> tuple[Run, Run, Run | None]:
    """Runs of a capture: as it is, as decoded by a subscriber, and as it came out over UDP."""
    with lidarcodec.open_source(capture, calibration=calibration) as source:
        sent = run_of(list(source.packets()))
    port, udp_port = free_port(), free_port()
    resent: list[Packet] = []
    ready, stop = threading.Event(), threading.Event()
    listener = threading.Thread(target=received_over_udp, args=(udp_port, resent, ready, stop))
    if udp:
        listener.start()
        ready.wait(10)
    live = lidarcodec.LiveStream(
        "identity/lidar",
        endpoints=lidarcodec.Endpoints(loopback_port=port),
        newest=False,
        timeout_s=FIRST_FRAME_S,
        until_end=True,
        udp=f"127.0.0.1:{udp_port}" if udp else None,
    )
    command = [sys.executable, "-m", "benchmarks.identity", "--publish", str(port), "--codec", codec, str(capture)]
    command += ["--calibration", str(calibration)] if calibration else []
    decoded: list[Packet] = []
    with live, subprocess.Popen(command) as publisher:
        for frame in live:
            decoded += lidarcodec.packets_of(frame)
        publisher.wait(30)
        while udp and len(resent) < sent.packets and live.summary()["udp"]["packets"] < sent.packets:
            time.sleep(0.1)
        time.sleep(LAST_PACKETS_S if udp else 0)
    stop.set()
    if udp:
        listener.join(10)
    return sent, run_of(decoded), run_of(resent) if udp else None


def publish(capture: Path, codec: str, calibration: Path | None, port: int) -> None:
    """The publisher's process: every frame, as fast as the receiver takes them."""
    with lidarcodec.open_source(capture, calibration=calibration) as source:
        lidarcodec.Publisher(
            source,
            lidarcodec.StreamSettings(codec=codec, framing=FRAMING),
            vehicle="identity",
            rate="max",
            endpoints=lidarcodec.Endpoints(loopback_port=port),
        ).run()


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("captures", nargs="+", type=Path)
    parser.add_argument("--codec", default="pcodec")
    parser.add_argument("--calibration", type=Path)
    parser.add_argument("--no-udp", action="store_true")
    parser.add_argument("--publish", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.publish:
        publish(options.captures[0], options.codec, options.calibration, options.publish)
        return 0
    bad = 0
    for capture in options.captures:
        began = time.perf_counter()
        sent, *others = through(capture, options.codec, options.calibration, not options.no_udp)
        same = all(other in (None, sent) for other in others)
        bad += not same
        counts = " ".join(f"{name} {run.packets}" for name, run in zip(("decoded", "udp"), others, strict=True) if run)
        verdict = "identical" if same else "DIFFERENT"
        took = time.perf_counter() - began
        print(f"{capture.name:34} sent {sent.packets} {counts}: {verdict}, {took:.0f} s", flush=True)
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
