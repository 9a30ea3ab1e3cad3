"""One end of a live stream as a process of its own, for tests that kill it. Prints a JSON object a line.

python -m tests.apps.runner publish  '{"loopback_port": 7447, "rate": 10}'
python -m tests.apps.runner subscribe '{"loopback_port": 7447}'
"""

from __future__ import annotations

import hashlib
import json
import os
import signal
import sys
import time
from typing import Any

import lidarcodec
from benchmarks.link_ends import looped
from lidarcodec.settings import settings_from
from tests.apps.streams import Loop


def say(**values: Any) -> None:
    """One line, whole, at once."""
    os.write(1, json.dumps(values).encode() + b"\n")


def publish(
    *,
    frames: int | None = None,
    source: str | None = None,
    rate: float | str = 10.0,
    settings: dict[str, Any],
    record: str | None = None,
    whole: bool = False,
    **where: Any,
) -> None:
    packets = Loop(frames, whole=whole) if source is None else looped(source)
    endpoints = lidarcodec.Endpoints.of(**where)
    publisher = lidarcodec.Publisher(packets, settings_from(settings), rate=rate, record=record, endpoints=endpoints)
    signal.signal(signal.SIGTERM, lambda *_: publisher.interrupt())
    with publisher:
        say(stream=publisher.stream_id)
        while not publisher.wait(0.1):
            if publisher._interrupted:
                break
            say(status=publisher.status())
    say(status=publisher.status())


def subscribe(*, work_s: float = 0.0, settings: dict[str, Any], **options: Any) -> None:
    begin = time.monotonic()
    with lidarcodec.subscribe(**options) as live:
        signal.signal(signal.SIGTERM, lambda *_: live.interrupt())
        say(open_s=time.monotonic() - begin)
        for frame in live:
            digest = hashlib.sha256(b"".join(p.payload for p in lidarcodec.packets_of(frame))).hexdigest()
            say(
                index=frame.index,
                stream=live.stats.stream_id,
                sha256=digest,
                since_s=time.monotonic() - begin,
                stamp_ns=frame.stamp_ns,
                latency_ms=(time.time_ns() - frame.stamp_ns - int(frame.side.packet_ns[-1])) / 1e6,
            )
            time.sleep(work_s)
        summary = live.summary()
    say(summary=summary)


if __name__ == "__main__":
    given = {"settings": {}} | json.loads(sys.argv[2])
    {"publish": publish, "subscribe": subscribe}[sys.argv[1]](**given)
