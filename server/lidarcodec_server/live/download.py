"""Download: the bytes of a recording as an answer. The recording cannot be deleted before the answer ends."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Final

from starlette.responses import FileResponse
from starlette.types import Message, Receive, Scope, Send

from lidarcodec_server.problems import ProblemError

MEDIA_TYPE: Final = "application/octet-stream"
"""MCAP has no registered media type."""
REASONS: Final = {
    400: "the header Range cannot be read: write bytes=FIRST-LAST",
    416: "the header Range begins behind the end of the recording",
}


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
