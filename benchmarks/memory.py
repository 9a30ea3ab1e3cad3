"""The publisher's memory after 1,000 frames, in a process of its own that a subscriber here listens to.

    python -m benchmarks.memory

The source is a simulated town, looped at four times the sensor's pace: 40 frames a second, more than are encoded.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from contextlib import closing
from itertools import islice
from pathlib import Path
from typing import Any

from benchmarks.scenes import FRAMING
from lidarcodec.apps.publisher.publisher import Publisher
from lidarcodec.apps.receiver.live_stream import LiveStream
from lidarcodec.settings import StreamSettings
from lidarcodec.sources import open_source
from lidarcodec.sources.captures.pcap_writer import PcapWriter
from lidarcodec.transport import Endpoints
from lidarcodec.transport.endpoints import free_port
from lidarcodec.units import FRAME_PACKETS

FRAMES = 1000
SAMPLE_FRAMES = 100
LOOPED_FRAMES = 10
SPEED = 4.0
VEHICLE, STREAM = "memory", "memory/lidar"


def memory_mib(process: int | str = "self") -> tuple[float, float]:
    """Resident memory of a process now, and its peak, in MiB."""
    values = {}
    for line in Path(f"/proc/{process}/status").read_text().splitlines():
        key, _, rest = line.partition(":")
        if key in ("VmRSS", "VmHWM"):
            values[key] = int(rest.split()[0]) / 1024
    return round(values["VmRSS"], 1), round(values["VmHWM"], 1)


def _publish(capture: str, endpoint: str) -> None:
    """The publisher's process: one JSON line with its memory after every hundred frames."""
    samples: list[float] = []
    with (
        closing(open_source(capture, realtime=True, loop=True, restamp=True, speed=SPEED)) as source,
        Publisher(
            source, StreamSettings(framing=FRAMING), vehicle=VEHICLE, endpoints=Endpoints.of(connect=[endpoint])
        ) as publisher,
    ):
        while publisher.status()["frames"] < FRAMES:
            if publisher.wait(0.05):
                break
            if publisher.status()["frames"] >= SAMPLE_FRAMES * (len(samples) + 1):
                samples.append(memory_mib()[0])
        print(json.dumps({"samples_mib": samples, "peak_mib": memory_mib()[1], "status": publisher.status()}))


def measure() -> dict[str, Any]:
    """What the publisher's process says after 1,000 frames."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with tempfile.TemporaryDirectory() as folder:
        capture = Path(folder) / "town.pcap"
        with open_source(f"sim:city?packets={LOOPED_FRAMES * FRAME_PACKETS}") as source, capture.open("wb") as file:
            PcapWriter(file).write_all(islice(source.packets(), LOOPED_FRAMES * FRAME_PACKETS))
        command = [sys.executable, "-m", "benchmarks.memory", "--publish", str(capture), endpoint]
        with (
            LiveStream(STREAM, endpoints=Endpoints.of(listen=[endpoint])) as live,
            subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as publisher,
        ):
            while publisher.poll() is None:
                live.next(0.2)
            out = publisher.stdout.read() if publisher.stdout else ""
    found: dict[str, Any] = json.loads(out.splitlines()[-1])
    return found


def publisher_memory() -> float:
    """Peak memory of the publisher over 1,000 frames, MiB."""
    return float(measure()["peak_mib"])


def main() -> int:
    """Measure and print; 1 if it is more than 250 MiB, or grew by more than 5 % from frame 200 on."""
    if sys.argv[1:2] == ["--publish"]:
        _publish(*sys.argv[2:4])
        return 0
    found = measure()
    samples = found["samples_mib"]
    growth = samples[-1] / samples[1] - 1
    sent, replaced = found["status"]["frames"], found["status"]["replaced"]
    print(f"publisher: {sent} frames sent, {replaced} replaced")
    print(f"peak {found['peak_mib']} MiB, {growth:+.1%} from frame 200 on")
    print("resident MiB after every hundred frames:", *samples)
    return int(found["peak_mib"] > 250 or growth > 0.05)


if __name__ == "__main__":
    sys.exit(main())
