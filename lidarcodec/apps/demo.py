"""The whole system on one machine: a vehicle's process publishes over loopback, this one decodes and shows.

A table on a terminal, plain lines elsewhere; at the end a summary, and a picture of the last frame.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any

from lidarcodec.apps.subscribe import LiveStream
from lidarcodec.codecs import table
from lidarcodec.errors import SourceError
from lidarcodec.frame import Frame
from lidarcodec.settings import StreamSettings
from lidarcodec.transport import Endpoints
from lidarcodec.units import PACKET_BYTES

VEHICLE, STREAM = "demo", "demo/lidar"
PICTURE = Path("demo-out") / "last-frame.png"
FIRST_FRAME_S = 30.0
"""Longest wait for the first frame."""
REDRAW_S = 0.25
LINE_S = 2.0
END_S = 5.0
NOT_FOR_THE_VEHICLE = {
    f"LIDARCODEC_{option}"
    for option in ("LISTEN", "ZENOH_CONFIG", "SENSOR", "RATE", "RECORD", "RECORD_AS", "RECORD_GB", "SET", "CODEC")
}
"""Options of `publish` that a user may have set for good; the demonstration says itself what its vehicle does."""


def free_port() -> int:
    """A TCP port of loopback that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def number(value: float | None, digits: int, unit: str = "") -> str:
    """A value as text; a dash for none."""
    return "-" if value is None else f"{value:,.{digits}f}{unit}"


@dataclass
class Figures:
    """What the table shows. Rates are over what was received; `replaced` counts on both sides."""

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
        """The same in one line."""
        return (
            f"{self.frames} frames, {number(self.fps, 1)}/s, ratio {number(self.ratio, 2)}, "
            f"{number(self.bits_per_point, 2)} bit/point, {number(self.kbps, 0)} kbit/s, "
            f"latency {number(self.p50_ms, 1)}/{number(self.p99_ms, 1)} ms, {self.replaced} replaced"
        )

    def rows(self) -> list[tuple[str, str]]:
        """Names and values, in the order in which they are shown."""

        def pair(first: float | None, second: float | None) -> str:
            return f"{number(first, 1)} / {number(second, 1, ' ms')}"

        return [
            ("frames", f"{self.frames:,}, {number(self.fps, 1)} a second"),
            ("ratio", f"{number(self.ratio, 2)} : 1, {self.fidelity}"),
            ("bits per point", f"{number(self.bits_per_point, 2)}, everything counted"),
            ("bitrate", f"{number(self.kbps, 0, ' kbit/s')} instead of {number(self.raw_kbps, 0)}"),
            ("latency p50 / p99", pair(self.p50_ms, self.p99_ms)),
            ("encode / decode p50", pair(self.encode_ms, self.decode_ms)),
            ("replaced", f"{self.replaced}, {self.errors} errors"),
        ]


class Demo:
    """Runs the demonstration.

    source: what the vehicle sees; seconds: from the first frame on; settings: of the stream
    words: further options of `publish`; picture: where the last frame is drawn
    """

    def __init__(
        self, source: str, seconds: float, settings: StreamSettings, words: list[str], picture: Path = PICTURE
    ) -> None:
        self._source, self._seconds, self._words, self._picture = source, seconds, words, picture
        self._fidelity = "packets come back byte for byte"
        if not table.codec(settings.codec).bounded:
            self._fidelity = "lossy, without a bound"
        elif settings.step > 1:
            self._fidelity = f"no range off by more than {settings.max_error_m} m"
        elif settings.intensity != "lossless":
            self._fidelity = f"ranges exact, intensity {settings.intensity}"
        self._interrupted = False
        self._live: LiveStream | None = None
        self._started = time.monotonic()
        self._packets = self._points = self._seen = 0
        self._last: Frame | None = None

    def interrupt(self) -> None:
        """End soon, with the summary. For signal handlers."""
        self._interrupted = True
        if self._live is not None:
            self._live.interrupt()

    def run(self) -> Figures:
        """Show everything, save the picture, print the summary.

        Raises SourceError when no frame came.
        """
        port = free_port()
        endpoint = f"tcp/127.0.0.1:{port}"
        with (  # this side listens: it is there when the vehicle's process calls
            TemporaryFile() as complaints,
            LiveStream(STREAM, endpoints=Endpoints.of(listen=[endpoint])) as live,
            _vehicle(self._source, endpoint, self._words, complaints) as vehicle,
        ):
            self._live = live
            self._wait_for_first(live, vehicle, complaints)
            self._watch(live, vehicle)
            figures = self.figures(live)
        self._summarise(figures)
        return figures

    def _wait_for_first(self, live: LiveStream, vehicle: subprocess.Popen[bytes], complaints: IO[bytes]) -> None:
        end = time.monotonic() + FIRST_FRAME_S
        while not self._interrupted:
            frame = live.next(REDRAW_S)
            if frame is not None:
                self._take(frame)
                self._started = time.monotonic()
                return
            if vehicle.poll() is not None or time.monotonic() > end:
                complaints.seek(0)
                said = complaints.read().decode(errors="replace").strip().removeprefix("lidarcodec: ")
                why = said or f"no frame in {FIRST_FRAME_S:g} s"
                raise SourceError(f"the publisher of {self._source} sent nothing: {why}")

    def _watch(self, live: LiveStream, vehicle: subprocess.Popen[bytes]) -> None:
        end = self._started + self._seconds
        with _display(self._source) as show:
            while time.monotonic() < end and not self._interrupted:
                frame = live.next(max(0.0, min(REDRAW_S, end - time.monotonic())))
                if frame is not None:
                    self._take(frame)
                elif vehicle.poll() is not None:
                    break
                show(self, live)

    def _take(self, frame: Frame) -> None:
        self._last = frame
        self._seen += 1
        self._packets += frame.side.packets if frame.side else 0
        self._points += frame.points

    def figures(self, live: LiveStream) -> Figures:
        """Where it stands now."""
        summary, status = live.summary(), live.status or {}
        latency, frames = summary["latency_ms"], summary.get("frames", 0)
        figures = Figures(
            frames=frames,
            seconds=time.monotonic() - self._started,
            fps=summary["fps"],
            p50_ms=latency["p50"],
            p99_ms=latency["p99"],
            encode_ms=(status.get("encode_ms") or {}).get("p50"),
            decode_ms=summary["decode_ms"]["p50"],
            replaced=status.get("replaced", 0) + summary["replaced"],
            errors=sum(summary["errors"].values()),
            fidelity=self._fidelity,
        )
        if frames and self._points:
            frame_bytes = summary["bytes"] / frames
            packets = self._packets / self._seen
            figures.ratio = packets * PACKET_BYTES / frame_bytes
            figures.bits_per_point = frame_bytes * 8 * self._seen / self._points
            if figures.fps is not None:
                figures.kbps = frame_bytes * 8 * figures.fps / 1000
                figures.raw_kbps = packets * PACKET_BYTES * 8 * figures.fps / 1000
        return figures

    def _summarise(self, figures: Figures) -> None:
        print(f"\n{self._source}, {figures.seconds:.0f} s, two processes over loopback:")
        for name, value in figures.rows():
            print(f"  {name:<20} {value}")
        if self._last is not None:
            from lidarcodec.apps.picture import picture_of, save_picture

            title = f"lidarcodec   {self._source}   frame {self._last.index}"
            if figures.ratio is not None:
                title += f"   {figures.ratio:.2f} : 1"
            try:
                save_picture(picture_of(self._last, title), self._picture)
            except OSError as error:  # a folder that cannot be written spoils no demonstration
                print(f"  {'last frame':<20} not saved: {error.strerror or error}")
            else:
                print(f"  {'last frame':<20} {self._picture}")


@contextmanager
def _vehicle(source: str, endpoint: str, words: list[str], complaints: IO[bytes]) -> Iterator[subprocess.Popen[bytes]]:
    """The publisher, in a process of its own."""
    command = [
        sys.executable,
        "-m",
        "lidarcodec.cli",
        "publish",
        source,
        "--vehicle",
        STREAM.split("/", maxsplit=1)[0],
        *words,
    ]
    process = subprocess.Popen(
        [*command, "--connect", endpoint],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=complaints,
        env={name: value for name, value in os.environ.items() if name not in NOT_FOR_THE_VEHICLE},
    )
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


@contextmanager
def _display(source: str) -> Iterator[Any]:
    """Function that shows where a demo stands: a table on a terminal, else a line every two seconds."""
    shown_s = 0.0

    def due(every_s: float) -> bool:
        nonlocal shown_s
        now = time.monotonic()
        if now - shown_s < every_s:
            return False
        shown_s = now
        return True

    if not sys.stdout.isatty():

        def line(demo: Demo, live: LiveStream) -> None:
            if due(LINE_S):
                print(demo.figures(live).line(), flush=True)

        yield line
        return
    from rich.live import Live
    from rich.table import Table

    with Live(refresh_per_second=8, transient=True) as screen:

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
