"""`lidarcodec subscribe`: receives and decodes a stream, and passes it on."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

from lidarcodec.apps.receiver.live_stream import LiveStream
from lidarcodec.commands.endpoints import Given, endpoints_of
from lidarcodec.commands.running.stopping import stoppable
from lidarcodec.commands.unkept import check_recorded
from lidarcodec.errors import SourceError

EVERY_S = 1.0


def run(
    key: str,
    udp: str | None,
    record: Path | None,
    frames: int | None,
    until_end: bool,
    receiver: str | None,
    given: Given,
    as_json: bool,
    with_clouds: bool = False,
) -> None:
    """Receive until a signal arrives, `frames` frames have come, or, with `until_end`, the publisher has stopped.

    Raises SourceError if it stopped before `frames` frames had come.
    """
    endpoints = endpoints_of(given)
    live = LiveStream(
        key, endpoints=endpoints, receiver=receiver, udp=udp, record=record, clouds=with_clouds, until_end=until_end
    )
    show = sys.stderr.isatty()
    count = 0
    with live, stoppable(live.interrupt) as stopped:
        shown_s = time.monotonic()
        for count, _ in enumerate(live, 1):
            if show and time.monotonic() - shown_s >= EVERY_S:
                shown_s = time.monotonic()
                sys.stderr.write(f"\r{line_of(live.summary())}\x1b[K")
            if count == frames:
                break
        summary = live.summary()
    summary["recording"] = live.summary()["recording"]  # after closing, when all waiting messages were written or lost
    if show:
        sys.stderr.write("\r\x1b[K")
    print(json.dumps(summary, indent=2) if as_json else line_of(summary))
    check_recorded({key: summary["recording"]})
    if frames is not None and count < frames and not stopped():
        raise SourceError(f"only {count} of {frames} frames came before the publisher of {key} stopped")


def line_of(summary: dict[str, Any]) -> str:
    """The state of a receiver, in one line."""
    latency = summary["latency_ms"]
    delay = "-" if latency["p50"] is None else f"{latency['p50']:.1f} ms (p99 {latency['p99']:.1f})"
    return (
        f"{summary.get('frames', 0)} frames, {summary['fps'] or 0:.1f} a second, {summary.get('bytes', 0):,} bytes, "
        f"latency {delay}, {summary.get('missing', 0)} missing, {sum(summary['errors'].values())} errors"
    )
