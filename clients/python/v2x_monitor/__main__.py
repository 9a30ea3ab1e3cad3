"""Watches zones with the eyes of several vehicles, and says when something stands in one.

python clients/python/v2x_monitor VEHICLE/SENSOR... --zone 'crossing=10,-4 18,-4 18,2 10,2' [--connect tcp/HOST:7447]
    [--out alerts.mcap] [--name monitor] [--seconds 60]

Vehicles must send poses in one common frame (`lidarcodec publish ... --poses`). Prints alerts as JSON, a line each, and
puts them on Zenoh; docs/v2x.md says what is where. Needs nothing but lidarcodec.
"""

from __future__ import annotations

import signal

signal.signal(signal.SIGINT, signal.SIG_DFL)  # whoever stops it while it is being loaded wants no traceback

# ruff: noqa: E402
import json
import os
import sys
import threading
import time
from typing import Any

import numpy as np
from options import options
from outputs import McapOutput, ZenohOutput
from zones import Event, Zone

import lidarcodec
from lidarcodec.errors import TransportError

STATE_S = 1.0
CLOCK_NS = 5 * 10**9
"""A vehicle whose clock is farther from this machine's is not looked at: its frames would count as seen later, or long
ago, and no other vehicle could raise or clear an alert where it looked."""
FAULTS = (lidarcodec.LidarCodecError, OSError)
"""What can go wrong with networks and files."""


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
        off_ns = frame.stamp_ns - time.time_ns()
        with self._lock:
            about = self._vehicles.setdefault(vehicle, {"frames": 0, "without_pose": 0, "wrong_clock": 0})
            about.update(frames=about["frames"] + 1, stamp_ns=frame.stamp_ns, latency_ms=latency_ms)
            if frame.pose is None:
                text = "sends no pose, so its points cannot be placed: publish it with --poses"
                self._leave_out(vehicle, "without_pose", text)
                return
            if abs(off_ns) > CLOCK_NS:
                text = f"has a clock that is {off_ns / 1e9:+.1f} s off this one, or a link that is so slow"
                self._leave_out(vehicle, "wrong_clock", f"{text}, so its points are not looked at: set both clocks")
                return
        place = frame.pose[:3, 3]
        before_ns, before = self._last.get(vehicle, (0, place))
        self._last[vehicle] = frame.stamp_ns, place
        since_s = (frame.stamp_ns - before_ns) * 1e-9
        velocity = (place - before) / since_s if 0.0 < since_s < 1.0 else np.zeros(3)
        points = in_common_frame(frame, velocity)
        with self._lock:
            about["position_m"] = place.round(2).tolist()
            for zone in self._zones:
                self._put(zone.see(points, frame.stamp_ns, vehicle))

    def tell(self) -> None:
        """Put out how things are. What nobody sees any more is forgotten, also if no vehicle is left."""
        with self._lock:
            for zone in self._zones:
                self._put(zone.go_on(time.time_ns()))
            seen = [things for zone in self._zones for things in zone.things.values()]
            state = {
                "stamp_ns": time.time_ns(), "frame": "world", "vehicles": dict(self._vehicles),
                "zones": [zone.state() for zone in self._zones],
            }  # fmt: skip
            for output in self._outputs:
                output.state(state, np.concatenate([np.zeros((0, 3)), *seen]))

    def _put(self, event: Event | None) -> None:
        """Put out an alert."""
        if event is not None:
            print(json.dumps(event.plain()), flush=True)
            for output in self._outputs:
                output.alert(event.plain())

    def _leave_out(self, vehicle: str, why: str, text: str) -> None:
        """Count a frame that is not looked at; the first one is said."""
        about = self._vehicles[vehicle]
        about[why] += 1
        if about[why] == 1:
            say(f"{vehicle} {text}")


class Watching:
    """Threads that hand the newest frames of streams to the monitor; they go on through restarts of vehicles."""

    def __init__(self, streams: list[str], endpoints: lidarcodec.Endpoints, monitor: Monitor) -> None:
        self._endpoints, self._monitor = endpoints, monitor
        self.stop = threading.Event()
        self.fault: BaseException | None = None
        self._threads = [threading.Thread(target=self._run, args=(one,)) for one in streams]

    def start(self) -> None:
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """End them; raises what ended one of them before."""
        self.stop.set()
        for thread in self._threads:
            if thread.ident is not None:
                thread.join()
        if self.fault is not None:
            raise self.fault

    def _run(self, stream: str) -> None:
        connect, port = list(self._endpoints.connect), self._endpoints.loopback_port
        try:
            with lidarcodec.subscribe(stream, connect=connect, loopback_port=port) as live:
                while not self.stop.is_set():
                    frame = live.next(timeout_s=0.5)
                    if frame is not None:
                        self._monitor.take(stream, frame, live.stats.latency_ms.summary()["p50"])
        except BaseException as error:  # also of this program: who watches no more must not seem to
            self.fault = error
            self.stop.set()


def say(text: str) -> None:
    """A line for whoever started this; alerts have standard output to themselves."""
    print(f"v2x_monitor: {text}", file=sys.stderr, flush=True)


def run() -> None:
    """Watch until a signal comes, or the time is over. Raises FAULTS."""
    given, zones = options(__doc__)
    endpoints = lidarcodec.Endpoints.of(connect=given.connect)
    file = None if given.out is None else McapOutput(given.out, say)
    outputs: list[Any] = [] if file is None else [file]
    monitor = Monitor(zones, outputs)
    watching = Watching(given.streams, endpoints, monitor)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: watching.stop.set())
    try:
        try:
            outputs.append(ZenohOutput(given.name, endpoints, watching.stop))
        except TransportError:
            if watching.stop.is_set():  # by a signal, before a router was there
                return
            raise
        watching.start()
        end = time.monotonic() + given.seconds
        while not watching.stop.wait(STATE_S) and time.monotonic() < end:
            monitor.tell()
        watching.close()
        monitor.tell()
    finally:
        watching.stop.set()
        for output in outputs:
            output.close()
    if file is not None and file.fault is not None:
        raise file.fault


def main() -> int:
    os.environ.setdefault("RUST_LOG", "off")  # Zenoh would write its log among the alerts
    try:
        run()
    except BrokenPipeError:  # whoever read the alerts has seen enough
        return 0
    except FAULTS as error:
        say(" ".join(str(error).split()))
        return 1
    except Exception as error:
        say(f"unexpected {type(error).__name__}: {' '.join(str(error).split())}")
        return 1
    sys.stdout.flush()
    return 0


if __name__ == "__main__":
    os._exit(
        main()
    )  # all is closed; a late thread of the network library could abort an interpreter that is going down
