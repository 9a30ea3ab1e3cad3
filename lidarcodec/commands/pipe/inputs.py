"""What comes on standard input: a capture, or messages, each with its size before it (u32, little endian)."""

from __future__ import annotations

import io
import os
import select
import struct
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final, cast

from lidarcodec.errors import SourceError
from lidarcodec.sources.captures.piped import PipedCapture
from lidarcodec.sources.magic import MCAP_MAGIC
from lidarcodec.wire.header import MAGIC, MAX_MESSAGE

NAME: Final = "standard input"
TICK_S: Final = 0.2
REST_S: Final = 1.0
"""Time for the rest of a pipe after a signal."""
_SIZE: Final = struct.Struct("<I")
_HEAD: Final = 8
"""Bytes that show the kind of an input."""


class Input(io.RawIOBase):
    """A pipe that ends when it is told to, though its other end may be silent. Gives what is there, as soon as it is.

    What waits in the pipe then is read first, for a second at most.

    within: whether a part of a message was read; its rest may still come in that second
    """

    def __init__(self, descriptor: int, stopped: Callable[[], bool]) -> None:
        """stopped: whether a signal came; asked several times a second"""
        self._descriptor, self.stopped = descriptor, stopped
        self.within = False
        self._head = b""
        self._last_s: float | None = None
        while len(self._head) < _HEAD and (more := self._take(_HEAD - len(self._head))):
            self._head += more
        self.head = self._head

    def readable(self) -> bool:
        """It is."""
        return True

    def readinto(self, buffer: Any) -> int:
        """Fill a buffer with what has come; 0 at the end."""
        view = memoryview(buffer).cast("B")
        if self._head:
            data, self._head = self._head[: len(view)], self._head[len(view) :]
        else:
            data = self._take(len(view))
        view[: len(data)] = data
        return len(data)

    def _take(self, size: int) -> bytes:
        while True:
            stopped, wait_s = self.stopped(), TICK_S
            if stopped:
                now_s = time.monotonic()
                self._last_s = self._last_s or now_s + REST_S
                if now_s > self._last_s:
                    return b""
                wait_s = min(TICK_S, self._last_s - now_s) if self.within else 0.0
            if select.select([self._descriptor], [], [], wait_s)[0]:
                return os.read(self._descriptor, min(size, 1 << 20))
            if stopped and not self.within:
                return b""


def is_messages(given: Input) -> bool:
    """Whether messages come. Raises SourceError for what cannot be read from a pipe."""
    if given.head == b"":
        raise SourceError(f"{NAME} is empty: pipe a capture or messages into this command")
    if given.head.startswith(MCAP_MAGIC[:_HEAD]):
        raise SourceError(f"a recording cannot be read from {NAME}: give its path, as `lidarcodec pipe drive.mcap`")
    return given.head[_SIZE.size :] == MAGIC


def messages(given: Input) -> Iterator[bytes]:
    """The messages. One that a signal cut is left out.

    Raises SourceError where the input ends within one for another reason, or says a size that none has.
    """
    while size := _exactly(given, _SIZE.size):
        (announced,) = _SIZE.unpack(size) if len(size) == _SIZE.size else (0,)
        if announced > MAX_MESSAGE:
            raise SourceError(f"{NAME} announces a message of {announced} bytes: the limit is {MAX_MESSAGE}")
        data = _exactly(given, announced)
        given.within = False
        if len(size) < _SIZE.size or len(data) < announced:
            if given.stopped():
                return
            raise SourceError(f"{NAME} ends within a message")
        yield data


def capture(given: Input, calibration: Path | None, model: str | None) -> PipedCapture:
    """The packets of a capture. Raises as CaptureSource."""
    return PipedCapture(cast(Any, given), NAME, calibration, model)


def _exactly(given: Input, size: int) -> bytes:
    """So many bytes; fewer at the end."""
    parts, left = [], size
    while left and (data := given.read(min(left, 1 << 20))):
        parts.append(data)
        left -= len(data)
        given.within = True
    return b"".join(parts)
