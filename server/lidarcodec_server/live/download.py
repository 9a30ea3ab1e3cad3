"""Downloads: recordings and clips as answers. Few at once, of all clients and of each."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Final

from starlette.responses import FileResponse
from starlette.types import Message, Receive, Scope, Send

from lidarcodec_server.limits import TooManyError
from lidarcodec_server.problems import ProblemError

MOST, MOST_A_CLIENT, AGAIN_S = 16, 4, 10
MEDIA_TYPE: Final = "application/octet-stream"
"""MCAP has no registered media type."""
REASONS: Final = {
    400: "the header Range cannot be read: write bytes=FIRST-LAST",
    416: "the header Range begins behind the end of the file",
}


class Downloads:
    """The places for downloads. Thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._running: Counter[str] = Counter()

    def take(self, client: str) -> Callable[[], None]:
        """Take a place; the function that is returned gives it back. client: name of the client

        Raises TooManyError.
        """
        with self._lock:
            if self._running.total() >= MOST or self._running[client] >= MOST_A_CLIENT:
                raise TooManyError("too many downloads are running: try again when one has ended", AGAIN_S)
            self._running[client] += 1

        def give_back() -> None:
            with self._lock:
                self._running -= Counter([client])

        return give_back


class Download(FileResponse):
    """Sends a file, or the ranges of it that a request wants. `connections` ends clients that do not read.

    ended: called once, when the answer is complete or its client is gone
    """

    def __init__(self, file: Path, name: str, ended: Callable[[], object]) -> None:
        super().__init__(file, media_type=MEDIA_TYPE, filename=name, stat_result=file.stat())
        self._ended = ended

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""

        async def checked(message: Message) -> None:
            status = message.get("status", 200)
            if status in REASONS:
                raise ProblemError(status, REASONS[status], "range")
            await send(message)

        try:
            await super().__call__(scope, receive, checked)
        finally:
            self._ended()
