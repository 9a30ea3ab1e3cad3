"""Watches zones with the eyes of several vehicles, and says when something stands in one.

python clients/python/v2x_monitor VEHICLE/SENSOR... --zone 'crossing=10,-4 18,-4 18,2 10,2' [--connect tcp/HOST:7447]
    [--out alerts.mcap] [--name monitor] [--seconds 60]

Vehicles must send poses in one common frame (`lidarcodec publish ... --poses`). Prints alerts as JSON, a line each, and
puts them on Zenoh; docs/v2x.md says what is where. Needs nothing but lidarcodec.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
from outputs import McapOutput, ZenohOutput
from zones import Rules, Zone

import lidarcodec

STATE_S = 1.0


def zone_of(text: str, rules: Rules) -> Zone:
    """A zone written as NAME=x,y x,y x,y."""
    name, _, corners = text.partition("=")
    try:
        return Zone(name, [[float(part) for part in corner.split(",")] for corner in corners.split()], rules)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"zone '{text}': write NAME=x,y x,y x,y ({error})") from None


def in_common_frame(frame: lidarcodec.Frame, velocity_mps: np.ndarray) -> np.ndarray:
    """(N, 3) points of a frame where its pose puts them, each moved by how far the vehicle had gone by then."""
    cloud = frame.cloud()
    points = np.stack([cloud[axis] for axis in "xyz"], axis=1).astype(np.float64)
    later_s = (cloud["t_ns"] - frame.stamp_ns)[:, None] * 1e-9
    return points @ frame.pose[:3, :3].T + frame.pose[:3, 3] + later_s * velocity_mps


class Monitor:
    """Takes the frames of all vehicles, each in a thread of its own."""

    def __init__(self, zones: list[Zone], outputs: list[Any]) -> None:
        self._zones, self._outputs = zones, outputs
        self._lock = threading.Lock()
        self._vehicles: dict[str, dict[str, Any]] = {}
        self._last: dict[str, tuple[int, np.ndarray]] = {}

    def take(self, vehicle: str, frame: lidarcodec.Frame, latency_ms: float | None) -> None:
        """Look at a frame."""
        about = self._vehicles.setdefault(vehicle, {"frames": 0, "without_pose": 0})
        about.update(frames=about["frames"] + 1, stamp_ns=frame.stamp_ns, latency_ms=latency_ms)
        if frame.pose is None:
            about["without_pose"] += 1
            return
        place = frame.pose[:3, 3]
        before_ns, before = self._last.get(vehicle, (0, place))
        self._last[vehicle] = frame.stamp_ns, place
        since_s = (frame.stamp_ns - before_ns) * 1e-9
        velocity = (place - before) / since_s if 0.0 < since_s < 1.0 else np.zeros(3)
        points = in_common_frame(frame, velocity)
        about["position_m"] = place.round(2).tolist()
        with self._lock:
            for zone in self._zones:
                event = zone.see(points, frame.stamp_ns, vehicle)
                if event is not None:
                    print(json.dumps(event.plain()), flush=True)
                    for output in self._outputs:
                        output.alert(event.plain())

    def tell(self) -> None:
        """Put out how things are."""
        with self._lock:
            seen = [things for zone in self._zones for things in zone.things.values()]
            state = {
                "stamp_ns": time.time_ns(), "frame": "world", "vehicles": dict(self._vehicles),
                "zones": [zone.state() for zone in self._zones],
            }  # fmt: skip
            for output in self._outputs:
                output.state(state, np.concatenate([np.zeros((0, 3)), *seen]))


def watch(stream: str, endpoints: lidarcodec.Endpoints, monitor: Monitor, stop: threading.Event) -> None:
    """Hand a stream's newest frames to the monitor until told to stop; it goes on through restarts of its vehicle."""
    with lidarcodec.subscribe(stream, connect=list(endpoints.connect), loopback_port=endpoints.loopback_port) as live:
        while not stop.is_set():
            frame = live.next(timeout_s=0.5)
            if frame is not None:
                monitor.take(stream, frame, live.stats.latency_ms.summary()["p50"])


def main() -> None:
    os.environ.setdefault("RUST_LOG", "off")  # Zenoh would write its log among the alerts
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("streams", nargs="+", metavar="VEHICLE/SENSOR")
    parser.add_argument(
        "--zone", action="append", required=True, metavar="NAME=x,y x,y x,y", help="in metres; repeatable"
    )
    parser.add_argument("--stand", type=float, default=2.0, help="seconds after which something stands")
    parser.add_argument("--clear", type=float, default=0.8, help="seconds seen free after which it no longer does")
    parser.add_argument(
        "--lowest", type=float, default=0.3, help="metres over the ground from which on something counts"
    )
    parser.add_argument("--connect", action="append", help="Zenoh endpoint; without one, this machine only")
    parser.add_argument("--name", default="monitor", help="of lidarcodec/v2x/NAME/alert and .../state")
    parser.add_argument("--out", type=Path, help="MCAP file for alerts, state, and the points in zones")
    parser.add_argument("--seconds", type=float, help="default: until a signal comes")
    options = parser.parse_args()

    rules = Rules(
        stand=max(2, round(10 * options.stand)), clear=max(1, round(10 * options.clear)), lowest_m=options.lowest
    )
    try:
        zones = [zone_of(text, rules) for text in options.zone]
    except argparse.ArgumentTypeError as error:
        parser.error(str(error))
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    endpoints = lidarcodec.Endpoints.of(connect=options.connect)
    outputs: list[Any] = [ZenohOutput(options.name, endpoints, stop)]
    if options.out is not None:
        outputs.append(McapOutput(options.out))
    monitor = Monitor(zones, outputs)
    threads = [threading.Thread(target=watch, args=(one, endpoints, monitor, stop)) for one in options.streams]
    for thread in threads:
        thread.start()
    end = None if options.seconds is None else time.monotonic() + options.seconds
    while not stop.wait(STATE_S) and (end is None or time.monotonic() < end):
        monitor.tell()
    stop.set()
    for thread in threads:
        thread.join()
    monitor.tell()
    for output in outputs:
        output.close()


if __name__ == "__main__":
    main()
    sys.stdout.flush()
    os._exit(0)  # all is closed; a late thread of the network library could abort an interpreter that is going down
