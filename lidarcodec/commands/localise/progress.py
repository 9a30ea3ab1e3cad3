"""Progress of `localise`: changes of state in lines on stderr, a line that stays on a terminal, and the summary."""

from __future__ import annotations

import sys
import time
from collections import deque
from typing import Any, Final

import numpy as np

from lidarcodec.commands.localise.messages import place_of
from lidarcodec.maps.localise.localiser import Localiser
from lidarcodec.maps.localise.tracker import Estimate, sigma_m

EVERY_S: Final = 1.0
REMEMBERED: Final = 10_000
"""Scans whose times and deviations are kept for the summary."""

WRONG_HINTS: Final = 3
"""After so many hints in a row that do not fit, a line is printed, once."""


class Progress:
    """Counts scans, and says when the position is found and lost."""

    def __init__(self, stream: str, localiser: Localiser) -> None:
        self.stream = stream
        self._localiser = localiser
        self._show = sys.stderr.isatty()
        self._first_s = self._shown_s = self._changed_s = time.monotonic()
        self._process_s = time.process_time()
        self._state = "searching"
        self._fix: tuple[float, int] | None = None
        self._last: Estimate | None = None
        self._wrong_before, self._hints_said = 0, False
        self.scans = self.poses = 0
        self._track_ms: deque[float] = deque(maxlen=REMEMBERED)
        self._sigmas: deque[float] = deque(maxlen=REMEMBERED)
        self._shares: deque[float] = deque(maxlen=REMEMBERED)

    def begin(self) -> float:
        """Note that a scan came; the processor time of this thread in seconds."""
        if not self.scans:
            self._first_s = self._changed_s = time.monotonic()
            self._process_s = time.process_time()
        self.scans += 1
        return time.thread_time()

    def tracked(self, begun: float, estimates: list[Estimate]) -> None:
        """Note the estimates of a scan, and of those that waited for a search."""
        self._track_ms.append(1000 * (time.thread_time() - begun) / len(estimates))
        for estimate in estimates:
            if estimate.pose is not None and estimate.covariance is not None:
                self.poses += 1
                self._last = estimate
                self._sigmas.append(sigma_m(estimate.covariance))
                self._shares.append(estimate.share * estimate.partners)
        self._say_change(estimates[-1].state)
        self._say_hints()
        now_s = time.monotonic()
        if self._show and now_s - self._shown_s >= EVERY_S:
            self._shown_s = now_s
            sys.stderr.write(f"\r{self.line()}\x1b[K")

    def end(self) -> None:
        """Clear the line on a terminal."""
        if self._show:
            sys.stderr.write("\r\x1b[K")

    def line(self) -> str:
        """The state in one line."""
        tracked = f"{self.stream}: {self._state}, {self.poses} of {self.scans} scans found"
        if self._last is None or self._last.pose is None or self._last.covariance is None:
            return tracked
        return f"{tracked}, last at {place_of(self._last.pose)}, +- {sigma_m(self._last.covariance):.3f} m"

    def summary(self) -> dict[str, Any]:
        """What the command prints at its end, as far as it is known here."""
        last, fix = self._last, self._fix
        pose = None if last is None or last.pose is None else last.pose
        return {
            "stream": self.stream,
            "scans": self.scans,
            "tracked": self.poses,
            "state": self._state,
            "first_fix_s": None if fix is None else round(fix[0], 3),
            "first_fix_scans": None if fix is None else fix[1],
            "lost": self._localiser.tracker.lost_times,
            "searches": self._localiser.searches,
            "given_up": self._localiser.given_up,
            "hints": self._localiser.hints,
            "wrong_hints": self._localiser.wrong_hints,
            "sigma_m": _rounded(np.median(self._sigmas)) if self._sigmas else None,
            "share": _rounded(np.median(self._shares)) if self._shares else None,
            "pose": None if pose is None else [round(value, 6) for value in pose[:3].ravel().tolist()],
            "stamp_ns": None if last is None else last.stamp_ns,
            "track_ms": {
                name: _rounded(np.percentile(self._track_ms, part)) if self._track_ms else None
                for name, part in (("p50", 50), ("p99", 99))
            },
            "process_ms": _rounded(1000 * (time.process_time() - self._process_s) / self.scans) if self.scans else None,
            "damaged_tiles": self._localiser.damaged_tiles,
        }

    def _say_change(self, state: str) -> None:
        if state == self._state:
            return
        now_s = time.monotonic()
        since = now_s - self._changed_s
        if state == "tracking":
            assert self._last is not None
            assert self._last.pose is not None
            found = "first fix" if self._fix is None else "found again"
            self._fix = self._fix or (now_s - self._first_s, self.scans)
            self._say(f"{found} after {since:.1f} s: {place_of(self._last.pose)}")
        elif state == "lost":
            self._say("lost: the scans do not lie in the map any more")
        self._state, self._changed_s = state, now_s

    def _say_hints(self) -> None:
        if self._state == "tracking":
            self._wrong_before = self._localiser.wrong_hints
        elif not self._hints_said and self._localiser.wrong_hints >= self._wrong_before + WRONG_HINTS:
            self._hints_said = True
            self._say("the poses on the key `odometry` do not fit the map: are they in its frame? The search goes on")

    def _say(self, text: str) -> None:
        clear = "\r\x1b[K" if self._show else ""
        sys.stderr.write(f"{clear}lidarcodec: {self.stream}: {text}\n")


def _rounded(value: Any) -> float:
    return round(float(value), 4)
