"""What came of a fault, as it was measured."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from typing import Any

from tests.apps.test_processes import End
from tests.transport.test_contract import eventually

PATIENCE_S = 40.0
"""How long something that has to happen may take on a machine that is busy with other work."""


@dataclass
class Outcome:
    """One row of the table.

    outage_s: longest time without a new frame at a receiver; 0.1 is none, because frames are 0.1 s apart
    lost, reported: what was lost for good; who says what about it
    wrong: what must not have happened, and did
    """

    fault: str
    outage_s: float | None
    lost: str
    reported: str
    figures: dict[str, Any] = field(default_factory=dict)
    wrong: list[str] = field(default_factory=list)

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self)


@contextlib.contextmanager
def ends() -> Iterator[Any]:
    """Function that starts an end of a stream as a process; all are killed at the end."""
    started: list[End] = []

    def start(role: str, **options: Any) -> End:
        started.append(End(role, **options))
        return started[-1]

    try:
        yield start
    finally:
        for one in started:
            if one.process.poll() is None:
                one.process.kill()
            one.end()


def await_frames(end: End, more: int = 5) -> None:
    """Wait until so many further frames have come.

    Raises TimeoutError when they do not.
    """
    before = len(end.frames)
    if not eventually(lambda: len(end.frames) >= before + more, PATIENCE_S):
        raise TimeoutError(f"only {len(end.frames) - before} of {more} frames came within {PATIENCE_S:g} s")


def outage_s(end: End, since_s: float, until_s: float | None = None) -> float:
    """Longest time between two frames from shortly before `since_s` (monotonic) on."""
    until_s = time.monotonic() if until_s is None else until_s
    times = [frame["at_s"] for frame in end.frames if frame["at_s"] <= until_s]
    before = [at for at in times if at <= since_s][-1:]
    after = [at for at in times if at > since_s]
    steps = [b - a for a, b in zip([*before, *after], after, strict=False)]
    return round(max(steps), 2) if steps else float("inf")


def resumed_s(end: End, since_s: float) -> float:
    """Time from a moment to the first frame behind it."""
    return round(
        min((frame["at_s"] for frame in end.frames if frame["at_s"] > since_s), default=float("inf")) - since_s, 2
    )


def missing(frames: list[dict[str, Any]]) -> int:
    """Indices left out between the first and the last of these frames of one stream."""
    return frames[-1]["index"] - frames[0]["index"] + 1 - len(frames) if frames else 0
