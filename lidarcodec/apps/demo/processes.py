"""The other processes of a demonstration: the vehicle that publishes, and the server that shows the page."""

from __future__ import annotations

import contextlib
import os
import queue
import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, Final

from lidarcodec.errors import TransportError
from lidarcodec.sources import spec
from lidarcodec.transport.endpoints import PORT_VARIABLE
from lidarcodec.transport.meeting_point import is_free

COMMAND: Final = (sys.executable, "-P", "-m", "lidarcodec.commands.running.attached")
"""Command of the processes. They end with this process in every case."""
PAGE_PORT: Final = 8080
"""Default port of the page."""
START_S: Final = 60.0
"""Longest wait for the server's address."""
END_S: Final = 5.0
NOT_FOR_THE_VEHICLE: Final = tuple(f"LIDARCODEC_{name}" for name in ("PUBLISH_", "LISTEN", "CONNECT", "ZENOH_CONFIG"))
"""Environment variables of the user that do not apply to the demonstration."""
ADDRESS: Final = re.compile(r"https?://[^ ]+")


def repeats(source: str) -> list[str]:
    """Words that begin a recorded source again at its end: a short one would be over before there are rates of it.

    >>> repeats("drive.pcap"), repeats("udp://0.0.0.0:2368")
    (['--loop'], [])
    """
    return [] if spec.parse(source).scheme in spec.LIVE else ["--loop"]


@contextmanager
def vehicle(
    source: str, name: str, meeting_port: int, words: list[str], complaints: IO[bytes]
) -> Iterator[subprocess.Popen[bytes]]:
    """Start the publisher. meeting_port: loopback port of the Zenoh session;  complaints: file for its stderr"""
    environment = {name: value for name, value in os.environ.items() if not name.startswith(NOT_FOR_THE_VEHICLE)}
    process = subprocess.Popen(
        # The page can compare decoded frames with uncompressed ones, which are sent only while a viewer compares.
        [*COMMAND, "publish", source, "--vehicle", name, "--original", *repeats(source), *words],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=complaints,
        env=environment | {PORT_VARIABLE: str(meeting_port)},
    )
    try:
        yield process
    finally:
        _end(process)


class PageServer:
    """The server of the page. Its database and recordings are temporary.

    port: of the page; None for 8080, or a free one if that is taken;  meeting_port: as for `vehicle`
    """

    def __init__(self, port: int | None, meeting_port: int) -> None:
        self.port, self._meeting_port = port, meeting_port
        self._folder = TemporaryDirectory(prefix="lidarcodec-demo-", ignore_cleanup_errors=True)
        self._again = False
        self._start(PAGE_PORT if port is None and is_free(PAGE_PORT) else port or 0)

    def address(self) -> str | None:
        """The page's address; None while it is not known yet. Does not wait.

        Raises TransportError with the server's error if there will be no page.
        """
        try:
            found = ADDRESS.search(self._said.get_nowait().decode(errors="replace"))
        except queue.Empty:
            if time.monotonic() < self._begun + START_S:
                return None
            found = None
        if found:
            return found[0]
        if self.port is None and not self._again:
            self._again = True
            _end(self._process)  # it may only have been slow
            self._start(0)  # on a free port, as another process may have taken this one
            return None
        try:
            said = self._complaints.get(timeout=1.0).decode(errors="replace").strip().removeprefix("lidarcodec: ")
        except queue.Empty:
            said = ""
        raise TransportError(f"the page cannot be shown: {said or f'its server did not start in {START_S:g} s'}")

    @property
    def ended(self) -> bool:
        """Whether the server process has ended."""
        return self._process.poll() is not None

    def close(self) -> None:
        """End the server."""
        _end(self._process)
        self._folder.cleanup()

    def __enter__(self) -> PageServer:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def _start(self, port: int) -> None:
        folder = Path(self._folder.name)
        words = ["--host", "127.0.0.1", "--port", str(port), "--database-url", f"sqlite:///{folder / 'server.db'}"]
        clean = {name: value for name, value in os.environ.items() if not name.startswith("LIDARCODEC_")}
        self._process = subprocess.Popen(
            [*COMMAND, "serve", *words, "--recordings", str(folder / "recordings")],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=clean | {PORT_VARIABLE: str(self._meeting_port)},
        )
        self._begun = time.monotonic()
        self._said, self._complaints = (_lines_of(pipe) for pipe in (self._process.stdout, self._process.stderr))


def _lines_of(pipe: IO[bytes] | None) -> queue.SimpleQueue[bytes]:
    """The first lines that come through a pipe, and an empty one at its end.

    The pipe is read to its end: a full pipe would block the server.
    """
    assert pipe is not None
    lines: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    threading.Thread(target=_pass_on, args=(pipe, lines), daemon=True).start()
    return lines


def _pass_on(pipe: IO[bytes], lines: queue.SimpleQueue[bytes]) -> None:
    with pipe:
        for line in pipe:
            if lines.qsize() < 100:
                lines.put(line)
    lines.put(b"")


def _end(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    end = time.monotonic() + END_S
    try:
        process.wait(max(0.0, end - time.monotonic()))
    except subprocess.TimeoutExpired:
        process.kill()
        with contextlib.suppress(subprocess.TimeoutExpired):  # a process inside a system call may end later
            process.wait(END_S)
    if process.stdin is not None:
        process.stdin.close()
