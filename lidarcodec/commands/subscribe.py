"""`lidarcodec subscribe`: receives and decodes a stream, and passes it on."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from lidarcodec.apps.notify import told_ready
from lidarcodec.apps.receiver.live_stream import LiveStream
from lidarcodec.commands.endpoints import Given, endpoints_of
from lidarcodec.commands.running.stopping import stoppable
from lidarcodec.commands.running.telling import tell
from lidarcodec.commands.unkept import check_recorded
from lidarcodec.errors import SourceError
from lidarcodec.evaluation.coding_losses import CodingLosses
from lidarcodec.frame import Frame
from lidarcodec.transport.keys import PREFIX
from lidarcodec.units import counted

EVERY_S = 1.0
SHOWN = 5
"""Most streams that are named instead of the one that is not there."""
ABSENT_S = 1.0
"""After this time without a publisher, the command says that it waits for one."""


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
    refine: bool = False,
) -> None:
    """Receive until a signal arrives, `frames` frames have come, or, with `until_end`, the publisher has stopped.

    Raises SourceError if it stopped before `frames` frames had come.
    """
    endpoints, stream, losses = endpoints_of(given), key.removeprefix(f"{PREFIX}/"), CodingLosses()
    live = LiveStream(
        key, endpoints=endpoints, receiver=receiver, udp=udp, record=record, clouds=with_clouds, until_end=until_end,
        refine=refine, on_message=losses.came,
    )  # fmt: skip
    show, count = sys.stderr.isatty(), 0
    with live, stoppable(live.interrupt) as stopped, told_ready(f"receiving {stream}", live.summary):
        shown_s = time.monotonic()
        for count, _ in enumerate(awaited(live, stream), 1):
            losses.told(live.status)
            if show and time.monotonic() - shown_s >= EVERY_S:
                shown_s = time.monotonic()
                now = live.summary()
                sys.stderr.write(f"\r{line_of(now, now['fps'])}\x1b[K")
            if count == frames:
                break
        summary = live.summary()
    summary["recording"] = live.summary()["recording"]  # after closing, when all waiting messages were written or lost
    if show:
        sys.stderr.write("\r\x1b[K")
    text = line_of(summary, summary["mean_fps"]) + losses.text()
    tell(summary | {"stream": stream, "coding": losses.values()}, text, as_json)
    check_recorded({key: summary["recording"]})
    if frames is not None and count < frames and not stopped():
        raise SourceError(f"only {count} of {frames} frames came before the publisher of {key} stopped")


def awaited(live: LiveStream, stream: str) -> Iterator[Frame]:
    """Frames of the stream. If it has no publisher at first, a line on stderr says so, and the wait goes on."""
    first = live.next(ABSENT_S)
    if first is not None:
        yield first
    elif not live.alive and not live.ended:
        there = named(live.others())
        sys.stderr.write(
            f"lidarcodec: nobody publishes {stream} yet; waiting.{there} Check the name, and --connect if it is "
            "elsewhere\n"
        )
    yield from live


def named(streams: list[str]) -> str:
    """Which streams there are, as a sentence; an empty text for none.

    >>> named(["car-7/roof"]), named([f"car-{n}/roof" for n in range(7)])
    (' There is car-7/roof.', ' There are car-0/roof, car-1/roof, car-2/roof, car-3/roof, car-4/roof and 2 more.')
    """
    if not streams:
        return ""
    first, more = ", ".join(streams[:SHOWN]), len(streams) - SHOWN
    return f" There {'is' if len(streams) == 1 else 'are'} {first}{f' and {more} more' if more > 0 else ''}."


def line_of(summary: dict[str, Any], fps: float | None) -> str:
    """The state of a receiver, in one line. fps: the rate, of the last frames or of all"""
    latency = summary["latency_ms"]
    delay = "-" if latency["p50"] is None else f"{latency['p50']:.1f} ms (p99 {latency['p99']:.1f})"
    rate = "" if fps is None else f", {fps:.1f} a second"
    return (
        f"{counted(summary.get('frames', 0), 'frame')}{rate}, {summary.get('bytes', 0):,} bytes, "
        f"latency {delay}, {summary.get('missing', 0)} missing, {sum(summary['errors'].values())} errors"
        + _refined(summary["refinements"])
        + _sent_by_udp(summary.get("udp"))
    )


def _sent_by_udp(counts: dict[str, int] | None) -> str:
    """What was sent by UDP, and what of it was not.

    >>> _sent_by_udp({"packets": 7184, "position packets": 12, "send errors": 3, "replaced": 1, "refused": 9})
    '; 7,196 packets sent by UDP, 3 not sent, 9 or more refused at the far end, 1 frame left out'
    """
    if counts is None:
        return ""
    sent = counts.get("packets", 0) + counts.get("position packets", 0)
    failed = counts.get("send errors", 0) + counts.get("position packets not sent", 0)
    left_out = counts.get("replaced", 0) + counts.get("no packets", 0)
    refused = counts.get("refused", 0)
    lost = (
        (failed, f"{failed:,} not sent"),
        (refused, f"{refused:,} or more refused at the far end"),
        (left_out, f"{counted(left_out, 'frame')} left out"),
    )
    return f"; {counted(sent, 'packet')} sent by UDP" + "".join(f", {text}" for count, text in lost if count)


def _refined(counts: dict[str, int] | None) -> str:
    if counts is None:
        return ""
    whole, part, base = (counts.get(name, 0) for name in ("whole", "part", "base"))
    return f"; {whole} refined whole, {part} in part, {base} base only"
