"""A vehicle that drives to and fro and keeps what it sees, as a process of its own. Prints a JSON object a line.

python -m tests.faults.past_vehicle '{"source": "drive.pcap", "keep": "ring", "settings": {}}'
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import lidarcodec
from benchmarks.link_ends import Turns
from lidarcodec.apps.past.keeper import Keep
from lidarcodec.packet import Packet
from lidarcodec.settings import settings_from
from lidarcodec.sources.pacing import PacedSource
from lidarcodec.units import FRAME_PACKETS
from tests.apps.runner import say
from tests.apps.test_processes import End
from tests.conftest import ROOT

SIZE = 8 * 10**9


def to_and_fro(spec: str) -> Turns:
    """The turns of a drive, forwards and then backwards. The packets of each turn stay in order, and times go on."""
    turns = Turns(spec)
    packets: list[Packet] = turns._packets
    there = [packets[at : at + FRAME_PACKETS] for at in range(0, len(packets), FRAME_PACKETS)]
    order = [*there, *reversed(there[1:-1])]
    flat = [packet.payload for turn in order for packet in turn]
    begin_ns, step_ns = packets[0].stamp_ns, 288_000
    turns._packets = [Packet(payload, begin_ns + number * step_ns) for number, payload in enumerate(flat)]
    return turns


def main(*, source: str, keep: str, settings: dict[str, Any], **where: Any) -> None:
    packets = PacedSource(to_and_fro(source), loop=True, restamp=True)
    publisher = lidarcodec.Publisher(
        packets, settings_from(settings), keep=Keep(Path(keep), SIZE), endpoints=lidarcodec.Endpoints.of(**where)
    )
    signal.signal(signal.SIGTERM, lambda *_: publisher.interrupt())
    with publisher:
        say(stream=publisher.stream_id)
        while not publisher.wait(0.5) and not publisher._interrupted:
            say(status=publisher.status())
    say(status=publisher.status())


class Vehicle(End):
    """The process."""

    def __init__(self, **options: Any) -> None:
        command = [sys.executable, "-m", "tests.faults.past_vehicle", json.dumps(options)]
        self._follow(subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True))


if __name__ == "__main__":
    main(**json.loads(sys.argv[1]))
