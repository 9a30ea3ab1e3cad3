"""The course of a training: how much of it is done, and what the network reached on drives that it does not learn from.

A training has a number of steps, or a time. With a time the learning rate goes by the clock, so that it is at its end
when the time is, however busy the machine. Such a run is continued where it was, but its weights depend on the machine.

The rate stays at its peak for four fifths of the time, and falls then: so a run that is given more time on the way has
lost nothing but the fall.

>>> Length(steps=200).done(50, seconds=1e9), Length(minutes=2.0).done(50, seconds=30.0)
(0.25, 0.25)
>>> Length(minutes=2.0).over(10**9, seconds=119.0), Length(minutes=2.0).over(1, seconds=120.0)
(False, True)
>>> [round(rate_by_clock(step, done, peak=1.0), 3) for step, done in ((9, 0.1), (900, 0.8), (999, 0.9), (1100, 1.0))]
[0.1, 1.0, 0.501, 0.003]
"""

from __future__ import annotations

import csv
import io
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from lidarcodec.errors import SourceError
from lidarcodec.files.whole import written_whole

WARM_UP: Final = 100
FALL: Final = 0.2
FLOOR: Final = 0.003
TIMES: Final = {"seconds": "minutes", "processor": "processor_minutes"}
"""Entries of a log that are seconds, and their columns."""


@dataclass(frozen=True)
class Length:
    """Of a training: `minutes` of training time if given, otherwise `steps`."""

    steps: int = 0
    minutes: float | None = None

    def done(self, step: int, seconds: float) -> float:
        """The share that is done after so many steps and seconds, 0 to 1."""
        share = step / max(self.steps, 1) if self.minutes is None else seconds / (60 * self.minutes)
        return min(share, 1.0)

    def over(self, step: int, seconds: float) -> bool:
        """Whether it has ended."""
        return self.done(step, seconds) >= 1.0


def rate_by_clock(step: int, done: float, *, peak: float) -> float:
    """Learning rate of a step when a share `done` of the time is over: up over WARM_UP steps, down in the last FALL."""
    left = min((1 - done) / FALL, 1.0)
    return peak * min((step + 1) / WARM_UP, 1.0) * (FLOOR + (1 - FLOOR) * left)


class Clock:
    """Training time and processor time, those of the run before an interruption included. seconds, processor: before"""

    def __init__(self, seconds: float = 0.0, processor: float = 0.0) -> None:
        self._wall, self._processor = time.monotonic() - seconds, time.process_time() - processor

    @property
    def seconds(self) -> float:
        """Of training time."""
        return time.monotonic() - self._wall

    @property
    def processor(self) -> float:
        """Seconds of processor time, of all threads."""
        return time.process_time() - self._processor


def rows_of(log: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The log of a checkpoint as rows of a table: one for each of `drives` in an entry, or one without a drive.

    >>> rows_of([{"step": 5, "seconds": 90.0, "drives": [{"drive": "city", "iou": {"low": 0.5}}]}])
    [{'step': 5, 'minutes': 1.5, 'drive': 'city', 'iou_low': 0.5}]
    """
    rows = []
    for entry in log:
        common = {}
        for name, value in entry.items():
            if name in TIMES:
                common[TIMES[name]] = round(value / 60, 2)
            elif name != "drives":
                common[name] = value
        rows += [common | _flat(found) for found in entry["drives"] or [{}]]
    return [{name: round(v, 6) if isinstance(v, float) else v for name, v in row.items()} for row in rows]


def _flat(found: Mapping[str, Any]) -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in found.items():
        inner = value.items() if isinstance(value, Mapping) else ()
        flat |= {f"{name}_{key}": part for key, part in inner} if inner else {name: value}
    return flat


def write_curve(path: Path, log: Sequence[Mapping[str, Any]]) -> None:
    """Write the log of a checkpoint as CSV, completely or not at all: see `rows_of`. Raises SourceError."""
    rows = rows_of(log)
    names = list(dict.fromkeys(name for row in rows for name in row))
    text = io.StringIO()
    table = csv.DictWriter(text, names, lineterminator="\n", restval="")
    table.writeheader()
    table.writerows(rows)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with written_whole(path) as beside:
            beside.write_text(text.getvalue())
    except OSError as error:
        raise SourceError(f"cannot write {path}: {error.strerror or error}") from None
