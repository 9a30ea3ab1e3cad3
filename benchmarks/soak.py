"""`make soak`: publish and subscribe for minutes, as two processes. Nothing is lost in silence, and memory stays flat.

    python -m benchmarks.soak [--minutes 10] [--source sim:city]

Exit code 1 if frames are unaccounted for, anything failed to decode, or a process grew by more than 5 %.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from dataclasses import dataclass, field
from typing import Any

from benchmarks.memory import memory_mib
from lidarcodec.apps.demo import free_port
from lidarcodec.apps.subscribe import LiveStream
from lidarcodec.transport import Endpoints

GROWTH_LIMIT = 0.05
LINE_S = 10.0
WARM_UP = 12
"""Lines before memory is compared: two minutes in which buffers and the scene around the car fill."""


@dataclass
class Run:
    """What was seen: memory of both sides every ten seconds, and what both sides said last."""

    ours: list[float] = field(default_factory=list)
    theirs: list[float] = field(default_factory=list)
    summary: dict[str, Any] = field(default_factory=dict)
    status: dict[str, Any] = field(default_factory=dict)

    def look(self, live: LiveStream) -> None:
        """Take what both sides say."""
        self.summary, self.status = live.summary(), live.status or {}

    def line(self) -> str:
        """Where it stands."""
        latency = self.summary["latency_ms"]
        return (
            f"{self.summary['frames']} frames, {self.summary.get('missing', 0)} missing, "
            f"{self.status.get('replaced', 0)} replaced, latency {latency['p50']} / {latency['p99']} ms, "
            f"publisher {self.theirs[-1]} MiB, subscriber {self.ours[-1]} MiB"
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
        for name, sizes in (("publisher", self.theirs), ("subscriber", self.ours)):
            warm = min(WARM_UP, len(sizes) // 2)
            if sizes and sizes[-1] > sizes[warm] * (1 + GROWTH_LIMIT):
                found.append(f"the {name} grew from {sizes[warm]} to {sizes[-1]} MiB")
        return found


def main() -> int:
    """Run, print a line every ten seconds, judge."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.soak", description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--source", default="sim:city")
    chosen = parser.parse_args()
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    command = [sys.executable, "-m", "lidarcodec.cli", "publish", chosen.source, "--vehicle", "soak"]
    run = Run()
    with (
        LiveStream("soak/lidar", endpoints=Endpoints.of(listen=[endpoint])) as live,
        subprocess.Popen([*command, "--connect", endpoint], stdout=subprocess.DEVNULL) as publisher,
    ):
        end = time.monotonic() + 60 * chosen.minutes
        next_line = time.monotonic() + LINE_S
        while time.monotonic() < end and publisher.poll() is None:
            live.next(0.2)
            if time.monotonic() >= next_line:
                next_line += LINE_S
                run.ours.append(memory_mib()[0])
                run.theirs.append(memory_mib(publisher.pid)[0])
                run.look(live)
                print(run.line(), flush=True)
        code = publisher.poll()
        run.look(live)
        publisher.terminate()
    wrong = run.wrong(code)
    for text in wrong:
        print(f"WRONG: {text}")
    print("soak: " + ("failed" if wrong else "nothing lost in silence, memory flat"))
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
