"""The whole system on one machine. One process publishes over loopback, one serves the page, and this one decodes and
counts.

It shows a table on a terminal, or plain lines; at the end a summary, and a picture of the last frame.
"""

from __future__ import annotations

import math
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, TYPE_CHECKING, Any, TextIO

from lidarcodec.apps.demo.browser import show as show_in_browser
from lidarcodec.apps.demo.processes import PageServer, vehicle
from lidarcodec.errors import LidarCodecError, MissingExtraError, SourceError, TransportError
from lidarcodec.evaluation.coding_losses import CodingLosses
from lidarcodec.frame import Frame
from lidarcodec.frame_images import payload_bytes

if TYPE_CHECKING:
    from lidarcodec.apps.receiver.live_stream import LiveStream

VEHICLE, STREAM = "demo", "demo/lidar"
PICTURE = Path("demo-out") / "last-frame.png"
FIRST_FRAME_S = 30.0
"""Longest wait for the first frame."""
BEGIN_S = 0.02
"""Interval at which the other processes are checked during the start."""
REDRAW_S = 0.25
LINE_S = 2.0
MADE = "MAKELEVEL" in os.environ
"""Set if `make demo` started this process."""
EXACT = "packets are restored byte for byte"
SECONDS = 20.0
"""Duration without a terminal, in seconds."""


def number(value: float | None, digits: int, unit: str = "") -> str:
    """A value as text; a dash for none."""
    return "-" if value is None else f"{value:,.{digits}f}{unit}"


@dataclass
class Figures:
    """Figures of the table. Rates are of received frames; `replaced` counts frames of sender and receiver."""

    frames: int = 0
    seconds: float = 0.0
    fps: float | None = None
    ratio: float | None = None
    bits_per_point: float | None = None
    kbps: float | None = None
    raw_kbps: float | None = None
    p50_ms: float | None = None
    p99_ms: float | None = None
    encode_ms: float | None = None
    decode_ms: float | None = None
    replaced: int = 0
    errors: int = 0
    fidelity: str = ""

    def line(self) -> str:
        """The figures in one line."""
        return (
            f"{self.frames} frames, {number(self.fps, 1)}/s, ratio {number(self.ratio, 2)}, "
            f"{number(self.bits_per_point, 2)} bit/point, {number(self.kbps, 0)} kbit/s, "
            f"latency {number(self.p50_ms, 1)}/{number(self.p99_ms, 1)} ms, {self.replaced} replaced"
        )

    def rows(self) -> list[tuple[str, str]]:
        """(name, value) of each row."""

        def pair(first: float | None, second: float | None) -> str:
            return f"{number(first, 1)} / {number(second, 1, ' ms')}"

        return [
            ("frames", f"{self.frames:,}, {number(self.fps, 1)} a second"),
            ("ratio", f"{number(self.ratio, 2)} : 1, {self.fidelity}"),
            ("bits per point", f"{number(self.bits_per_point, 2)}, all data included"),
            ("bitrate", f"{number(self.kbps, 0, ' kbit/s')} instead of {number(self.raw_kbps, 0)}"),
            ("latency p50 / p99", pair(self.p50_ms, self.p99_ms)),
            ("encode / decode p50", pair(self.encode_ms, self.decode_ms)),
            ("replaced", f"{self.replaced}, {self.errors} errors"),
        ]


class Demo:
    """Runs the demonstration.

    source: the vehicle's source; seconds: from the first frame on. None: until interrupted on a terminal, otherwise 20
    words: further options of `publish`
    browser: whether to open the page;  out: where to print, standard output by default
    address: of the page;  saved: path of the picture; None until then;  losses: what coding left out
    """

    def __init__(
        self,
        source: str,
        seconds: float | None,
        words: list[str],
        *,
        browser: bool = True,
        out: TextIO | None = None,
    ) -> None:
        self._source, self._seconds, self._words = source, seconds, words
        self._browser, self._out = browser, out or sys.stdout
        self.address: str | None = None
        self.saved: str | None = None
        self.losses = CodingLosses()
        self._interrupted, self._parent = False, os.getppid()
        self._live: LiveStream | None = None
        self._started = time.monotonic()
        self._raw_bytes = self._points = self._seen = 0
        self._last: Frame | None = None

    def interrupt(self) -> None:
        """Stop soon and print the summary. For signal handlers."""
        self._interrupted = True
        if self._live is not None:
            self._live.interrupt()

    @property
    def _stopped(self) -> bool:
        """Whether to stop: after an interrupt, or if the `make` that started this was killed."""
        return self._interrupted or (MADE and os.getppid() != self._parent)

    def run(self, server: PageServer, meeting_port: int) -> Figures:
        """Run, save the picture, print the summary. meeting_port: loopback port of the Zenoh session

        Raises SourceError if no frame came or one of its processes failed, TransportError if the given port is in use.
        """
        with (
            TemporaryFile() as complaints,
            vehicle(self._source, VEHICLE, meeting_port, self._words, complaints) as car,
            _listening(meeting_port, self.losses) as live,
        ):
            self._live = live
            page = self._begin(server, live, car, complaints)
            fault = self._watch(live, car, server if page else None, self._limit_s(page=page))
            figures = self.figures(live, whole=True)
        self._summarise(figures)
        if fault:
            raise SourceError(fault)
        return figures

    def _begin(self, server: PageServer, live: LiveStream, car: subprocess.Popen[bytes], complaints: IO[bytes]) -> bool:
        """Wait for the page's address and the first frame. False: there is no page.

        Frames are taken meanwhile, as a waiting frame would be replaced by the next.
        """
        page: bool | None = None
        end = time.monotonic() + FIRST_FRAME_S
        while (page is None or self._last is None) and not self._stopped:
            if page is None:
                page = self._open_page(server)
            frame = live.next(BEGIN_S)
            if frame is not None:
                if self._last is None:
                    self._started = time.monotonic()
                self._take(frame)
            elif self._last is None and (car.poll() is not None or time.monotonic() > end):
                complaints.seek(0)
                said = complaints.read().decode(errors="replace").strip().removeprefix("lidarcodec: ")
                why = said or f"no frame in {FIRST_FRAME_S:g} s"
                raise SourceError(f"the vehicle process sent nothing from {self._source}: {why}")
        return bool(page)

    def _open_page(self, server: PageServer) -> bool | None:
        """Print the page's address and open a browser. None: the address is not known yet; False: there is no page."""
        try:
            address = server.address()
        except TransportError as error:
            if server.port is not None:
                raise
            self._print(f"{error}.")
            return False
        if address is None:
            return None
        opened = self._browser and show_in_browser(address)
        self.address = address
        self._print(f"The page is at {address}{' and opens in the browser' if opened else ''}")
        return True

    def _limit_s(self, *, page: bool) -> float:
        """Time limit in seconds."""
        if self._seconds is not None:
            return self._seconds
        if not page or not self._out.isatty():
            return SECONDS
        self._print("Press Ctrl-C to stop.")
        return math.inf

    def _watch(
        self, live: LiveStream, car: subprocess.Popen[bytes], server: PageServer | None, limit_s: float
    ) -> str | None:
        """Show figures until the end. Returns the reason of an early end, if any. server: the page's server, or None"""
        end = self._started + limit_s
        with _display(self._source, self._out) as show:
            while time.monotonic() < end and not self._stopped:
                frame = live.next(max(0.0, min(REDRAW_S, end - time.monotonic())))
                if frame is not None:
                    self._take(frame)
                elif car.poll() is not None:
                    return (
                        f"the publisher of {self._source} ended with code {car.returncode}" if car.returncode else None
                    )
                if server is not None and server.ended and not self._stopped:
                    return "the server of the page stopped unexpectedly"
                show(self, live)
        return None

    def _take(self, frame: Frame) -> None:
        self._last = frame
        self._seen += 1
        self._raw_bytes += payload_bytes(frame)
        self._points += frame.points

    def figures(self, live: LiveStream, *, whole: bool = False) -> Figures:
        """The current figures. whole: with the mean rate of all frames in place of the rate now"""
        summary, status = live.summary(), live.status or {}
        latency, frames = summary["latency_ms"], summary.get("frames", 0)
        figures = Figures(
            frames=frames,
            seconds=time.monotonic() - self._started,
            fps=summary["mean_fps" if whole else "fps"],
            p50_ms=latency["p50"],
            p99_ms=latency["p99"],
            encode_ms=(status.get("encode_ms") or {}).get("p50"),
            decode_ms=summary["decode_ms"]["p50"],
            replaced=status.get("replaced", 0) + summary["replaced"],
            errors=sum(summary["errors"].values()),
        )
        self.losses.told(live.status)
        if frames:
            figures.fidelity = self.losses.text().removeprefix(", ") or EXACT
        if frames and self._points:
            frame_bytes = summary["bytes"] / frames
            raw_bytes = self._raw_bytes / self._seen
            figures.ratio = raw_bytes / frame_bytes
            figures.bits_per_point = frame_bytes * 8 * self._seen / self._points
            if figures.fps is not None:
                figures.kbps = frame_bytes * 8 * figures.fps / 1000
                figures.raw_kbps = raw_bytes * 8 * figures.fps / 1000
        return figures

    def _print(self, text: str) -> None:
        print(text, file=self._out, flush=True)

    def _summarise(self, figures: Figures) -> None:
        self._print(f"\n{self._source}, {figures.seconds:.0f} s, vehicle and receiver on this machine:")
        for name, value in figures.rows():
            self._print(f"  {name:<20} {value}")
        if self._last is not None:
            title = f"lidarcodec   {self._source}   frame {self._last.index}"
            if figures.ratio is not None:
                title += f"   {figures.ratio:.2f} : 1"
            try:
                _save(self._last, title, PICTURE)
            except (OSError, LidarCodecError) as error:  # without a picture the demonstration is still complete
                self._print(f"  {'last frame':<20} not saved: {error}")
            else:
                self.saved = str(PICTURE)
                self._print(f"  {'last frame':<20} {PICTURE}")


def _save(frame: Frame, title: str, path: Path) -> None:
    """Write a picture of a frame.

    Raises MissingExtraError, OSError, SettingsError or SourceError.
    """
    try:
        from lidarcodec.apps.picture import picture_of, save_picture
    except ModuleNotFoundError:
        raise MissingExtraError("a picture", "server") from None
    save_picture(picture_of(frame, title), path)


def _listening(meeting_port: int, losses: CodingLosses) -> LiveStream:
    """A subscription to the vehicle's stream. Its modules are imported here, while the other processes start."""
    from lidarcodec.apps.receiver.live_stream import LiveStream
    from lidarcodec.transport import Endpoints

    return LiveStream(STREAM, endpoints=Endpoints.of(loopback_port=meeting_port), on_message=losses.came)


@contextmanager
def _display(source: str, out: TextIO) -> Iterator[Any]:
    """A function that shows the figures: as a table on a terminal, otherwise as a line every two seconds."""
    shown_s = 0.0

    def due(every_s: float) -> bool:
        nonlocal shown_s
        now = time.monotonic()
        if now - shown_s < every_s:
            return False
        shown_s = now
        return True

    if not out.isatty():

        def line(demo: Demo, live: LiveStream) -> None:
            if due(LINE_S):
                print(demo.figures(live).line(), file=out, flush=True)

        yield line
        return
    from rich.console import Console
    from rich.live import Live
    from rich.table import Table

    with Live(console=Console(file=out), refresh_per_second=8, transient=True) as screen:

        def table(demo: Demo, live: LiveStream) -> None:
            if due(REDRAW_S):
                grid = Table(
                    title=f"{source}: vehicle -> Zenoh over loopback -> here", title_justify="left", min_width=64
                )
                grid.add_column("", style="dim")
                grid.add_column("now", justify="left", style="bold")
                for name, value in demo.figures(live).rows():
                    grid.add_row(name, value)
                screen.update(grid)

        yield table
