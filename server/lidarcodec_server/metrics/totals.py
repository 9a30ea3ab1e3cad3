"""Totals: counts of a stream since the server saw it first. They survive restarts of its publisher and receivers.

A publisher counts from zero at each start. The totals here only increase. A publisher that has run for long when the
server hears of it first has counted what was before: otherwise an error of last week would be one of now whenever the
server starts. What one that has just started counts is new.

>>> totals = Totals()
>>> totals.status({"stream_id": "one", "frames": 1000}); totals.status({"stream_id": "one", "frames": 1002})
>>> totals.status({"stream_id": "two", "frames": 3})
>>> totals["frames"], totals["restarts"]
(5.0, 1.0)
"""

from __future__ import annotations

import math
from collections import OrderedDict
from typing import Any

from lidarcodec.apps.timings import BOUNDS_MS

MAX_SENDERS = 32
"""Number of publisher starts and receivers, for each stream, with remembered counts."""
SENT = ("frames", "messages", "bytes", "key_frames", "replaced", "no_receiver", "left_out")
ERRORS = ("encode errors", "put errors")
LOST = ("lost packets", "kernel drops", "queue drops")
UNSTORED = ("dropped", "not recorded")
JUST_STARTED = 50
"""A publisher that has made at most so many frames has just started: its first status comes within a second."""
RECEIVED = ("frames", "missing", "decode_errors", "missing_references")
TIMES = {"encode": "encode_ms", "put": "put_ms"}
RECEIVED_TIMES = {"decode": "decode", "latency": "latency"}
BUCKETS = len(BOUNDS_MS) + 1


class Totals:
    """Sums by name. Not thread-safe."""

    def __init__(self) -> None:
        self._sums: dict[str, float] = {}
        self._last: OrderedDict[str, dict[str, float]] = OrderedDict()
        self._begun = False

    def __getitem__(self, name: str) -> float:
        return self._sums.get(name, 0.0)

    def take(self, sender: str, counts: dict[str, float]) -> None:
        """Add the present counts of `sender`. If a count went down, it started again at zero."""
        last = self._last.pop(sender, {})
        for name, count in counts.items():
            grown = count - last.get(name, 0.0)
            self._sums[name] = self._sums.get(name, 0.0) + (grown if grown >= 0 else count)
        self._last[sender] = counts
        while len(self._last) > MAX_SENDERS:
            self._last.popitem(last=False)

    def histogram(self, name: str) -> tuple[list[tuple[str, float]], float]:
        """(upper bound in seconds, count up to it) for each bucket, and the sum in seconds."""
        bounds = [f"{bound / 1e3:g}" for bound in BOUNDS_MS] + ["+Inf"]
        up_to, out = 0.0, []
        for number, bound in enumerate(bounds):
            up_to += self[f"{name} {number}"]
            out.append((bound, up_to))
        return out, self[f"{name} sum"] / 1e3

    def status(self, status: dict[str, Any]) -> None:
        """Add a publisher's status: its own counts, and those of receivers in it. The first one of a stream adds
        nothing, unless its publisher has just started.
        """
        start = status.get("stream_id")
        if not isinstance(start, str) or len(start) > 64:
            return
        counts = _counts(status, SENT) | _counts(_record(status.get("errors")), ERRORS)
        counts |= _counts(_record(status.get("source")), LOST)
        for name in ("recording", "past"):
            stored = _counts(_record(_record(status.get(name)).get("counts")), UNSTORED)
            counts[f"{name} unstored"] = sum(stored.values())
        for name, field in TIMES.items():
            counts |= _times(name, status.get(field))
        if self._begun and f"start {start}" not in self._last:
            self._sums["restarts"] = self["restarts"] + 1
        self.take(f"start {start}", counts)
        reports = status.get("reports")
        for receiver, report in list(reports.items())[:16] if isinstance(reports, dict) else []:
            if isinstance(report, dict):
                self.take(f"receiver {receiver[:64]} {report.get('start')}", _received(report))
        if not self._begun:
            self._begun = True
            made = sum(self[name] for name in ("frames", "replaced", "no_receiver", "left_out"))
            if made > JUST_STARTED:
                self._sums.clear()


def _record(value: object) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}


def _received(report: dict[str, Any]) -> dict[str, float]:
    counts = {f"received {name}": value for name, value in _counts(report, RECEIVED).items()}
    for name, field in RECEIVED_TIMES.items():
        values = report.get(f"{field}_buckets")
        if isinstance(values, list) and len(values) == BUCKETS and all(_is_count(value) for value in values):
            counts |= {f"{name} {number}": float(value) for number, value in enumerate(values)}
            counts |= {f"{name} sum": value for value in _counts(report, (f"{field}_sum_ms",)).values()}
    return counts


def _times(name: str, summary: object) -> dict[str, float]:
    """Counts from a summary of `Timings` with its buckets."""
    buckets = summary.get("buckets") if isinstance(summary, dict) else None
    if not isinstance(summary, dict) or not isinstance(buckets, dict):
        return {}
    keys = [f"{bound:g}" for bound in BOUNDS_MS] + ["more"]
    values: list[Any] = [buckets.get(key) for key in keys]
    if not all(_is_count(value) for value in values):
        return {}
    counts = {f"{name} {number}": float(value) for number, value in enumerate(values)}
    return counts | {f"{name} sum": value for value in _counts(summary, ("sum",)).values()}


def _counts(values: dict[str, Any], names: tuple[str, ...]) -> dict[str, float]:
    return {name: float(values[name]) for name in names if _is_count(values.get(name))}


def _is_count(value: object) -> bool:
    return (
        isinstance(value, int | float) and not isinstance(value, bool) and 0 <= value < 2**63 and math.isfinite(value)
    )
