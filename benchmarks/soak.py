"""`make soak`: publish and subscribe for long, as two processes. Nothing is lost in silence, and nothing grows.

    python -m benchmarks.soak [--minutes 10] [--source sim:city]          as a sensor sends, newest first
    python -m benchmarks.soak --frames 36000 --rate max [--codec NAME]    every frame, as fast as both sides can

With `--rate max` the first 50 frames of the source are played from memory, over and over. Exit code 1 if frames are
unaccounted for, anything failed to decode, or memory, threads or open files of a process grew.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.memory import memory_mib
from benchmarks.scenes import FRAMING
from lidarcodec.apps.publisher.publisher import Publisher
from lidarcodec.apps.receiver.live_stream import LiveStream
from lidarcodec.apps.swarm import loaded
from lidarcodec.packet import Packet
from lidarcodec.sensor_model import SensorModel
from lidarcodec.settings import StreamSettings
from lidarcodec.sources.base import PacketSource
from lidarcodec.transport import Endpoints
from lidarcodec.transport.endpoints import free_port
from lidarcodec.units import PACKET_INTERVAL_US

GROWTH_LIMIT = 0.05
MORE_THREADS, MORE_FILES = 2, 4
"""What may come and go: a thread that closes something, a socket of a connection that is made again."""
LINE_S = 10.0
WARM_UP = 12
"""Lines before sizes are compared: two minutes in which buffers and the scene around the car fill."""
LOOPED_FRAMES = 50
VEHICLE = "soak"


class Sizes(NamedTuple):
    """Of a process: resident memory in MiB, threads, open files and sockets."""

    memory_mib: float
    threads: int
    files: int


def sizes(process: int | str = "self") -> Sizes:
    """What a process takes now."""
    status = Path(f"/proc/{process}/status").read_text()
    threads = int(status.partition("Threads:")[2].split()[0])
    return Sizes(memory_mib(process)[0], threads, len(list(Path(f"/proc/{process}/fd").iterdir())))


def grown(name: str, seen: list[Sizes]) -> list[str]:
    """What grew between the end of the warm-up and the end."""
    if len(seen) < 2:
        return []
    warm, last = seen[min(WARM_UP, len(seen) // 2)], seen[-1]
    found = []
    if last.memory_mib > warm.memory_mib * (1 + GROWTH_LIMIT):
        found.append(f"the {name} grew from {warm.memory_mib} to {last.memory_mib} MiB")
    if last.threads > warm.threads + MORE_THREADS:
        found.append(f"the {name} has {last.threads} threads, and had {warm.threads}")
    if last.files > warm.files + MORE_FILES:
        found.append(f"the {name} has {last.files} open files, and had {warm.files}")
    return found


@dataclass
class Run:
    """What was seen: sizes of both sides every ten seconds, and what both sides said last."""

    ours: list[Sizes] = field(default_factory=list)
    theirs: list[Sizes] = field(default_factory=list)
    summary: dict[str, Any] = field(default_factory=dict)
    status: dict[str, Any] = field(default_factory=dict)

    def look(self, live: LiveStream) -> None:
        """Take what both sides say."""
        self.summary, self.status = live.summary(), live.status or {}

    def line(self) -> str:
        """Where it stands."""
        latency, ours, theirs = self.summary["latency_ms"], self.ours[-1], self.theirs[-1]
        return (
            f"{self.summary.get('frames', 0)} frames, {self.summary['fps'] or 0:.1f} a second, "
            f"{self.summary.get('missing', 0)} missing, {self.status.get('replaced', 0)} replaced, "
            f"latency {latency['p50']} / {latency['p99']} ms; MiB, threads, files: "
            f"publisher {theirs.memory_mib}, {theirs.threads}, {theirs.files}; "
            f"subscriber {ours.memory_mib}, {ours.threads}, {ours.files}"
        )

    def wrong(self, code: int | None) -> list[str]:
        """Everything that must not be; `code` is that of a publisher that ended by itself."""
        found = [] if code in (None, 0) else [f"the publisher ended with code {code}"]
        if sum(self.summary["errors"].values()):
            found.append(f"errors: {self.summary['errors']}")
        missing = self.summary.get("missing", 0)
        explained = self.status.get("replaced", 0) + self.status.get("no_receiver", 0)
        if missing > explained:
            found.append(f"{missing} frames are missing, {explained} of them were replaced or had no receiver")
        return found + grown("publisher", self.theirs) + grown("subscriber", self.ours)


class Endless(PacketSource):
    """Packets in memory, over and over, as fast as they are taken; their stamps go on."""

    def __init__(self, sensor: SensorModel, packets: list[Packet]) -> None:
        super().__init__(sensor)
        self._packets = packets

    def packets(self) -> Iterator[Packet]:
        """One turn after the other, until closed."""
        turn_ns = self._packets[-1].stamp_ns - self._packets[0].stamp_ns + PACKET_INTERVAL_US * 1000
        shift_ns = 0
        while not self.closed:
            for packet in self._packets:
                yield Packet(packet.payload, packet.stamp_ns + shift_ns)
            shift_ns += turn_ns


def publish_every(source: str, codec: str, endpoint: str) -> None:
    """The publisher's process with `--rate max`: every frame, until it is stopped."""
    settings = StreamSettings(codec=codec, framing=FRAMING)
    sensor, packets = loaded(source, LOOPED_FRAMES)
    endpoints = Endpoints.of(connect=[endpoint])
    with Publisher(Endless(sensor, packets), settings, vehicle=VEHICLE, rate="max", endpoints=endpoints) as publisher:
        publisher.wait()


def main() -> int:
    """Run, print a line every ten seconds, judge."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.soak", description=__doc__)
    parser.add_argument("--minutes", type=float, help="default: 10, or with --frames as long as it takes")
    parser.add_argument("--frames", type=int)
    parser.add_argument("--rate", choices=("10", "max"), default="10")
    parser.add_argument("--codec", default="pcodec")
    parser.add_argument("--source", default="sim:city")
    parser.add_argument("--publish-to", help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.publish_to:
        publish_every(chosen.source, chosen.codec, chosen.publish_to)
        return 0
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    every = chosen.rate == "max"
    command = [sys.executable, "-m", "lidarcodec.cli", "publish", chosen.source, "--vehicle", VEHICLE]
    command += ["--codec", chosen.codec, "--set", f"framing={FRAMING}", "--connect", endpoint]
    if every:
        own = ["--source", chosen.source, "--codec", chosen.codec, "--publish-to", endpoint]
        command = [sys.executable, "-m", "benchmarks.soak", *own]
    minutes = chosen.minutes or (1e9 if chosen.frames else 10.0)
    run, begin = Run(), time.monotonic()
    with (
        LiveStream(f"{VEHICLE}/lidar", endpoints=Endpoints.of(listen=[endpoint]), newest=not every) as live,
        subprocess.Popen(command, stdout=subprocess.DEVNULL) as publisher,
    ):
        end, next_line, count = begin + 60 * minutes, begin + LINE_S, 0
        while time.monotonic() < end and publisher.poll() is None and count != chosen.frames:
            count += live.next(0.2) is not None
            if time.monotonic() >= next_line:
                next_line += LINE_S
                run.ours.append(sizes())
                run.theirs.append(sizes(publisher.pid))
                run.look(live)
                print(run.line(), flush=True)
        code = publisher.poll()
        run.look(live)
        publisher.terminate()
    wrong = run.wrong(code)
    if chosen.frames and count < chosen.frames:
        wrong.append(f"only {count} of {chosen.frames} frames came")
    for text in wrong:
        print(f"WRONG: {text}")
    came_of_it = "failed" if wrong else "nothing lost in silence, nothing grew"
    print(f"soak, {count} frames in {time.monotonic() - begin:.0f} s: {came_of_it}")
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
