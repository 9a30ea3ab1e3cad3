"""ViewerLog: what Foxglove's server says of its viewers, each kind of it once.

That server writes a line for every wrong message of a viewer, and one message may hold thousands of mistakes: a viewer
could fill the disk that keeps the log.

>>> kind_of("Client 127.0.0.1:5000 attempted to subscribe to unknown channel: 77")
'Client ... attempted to subscribe to unknown channel: ...'
"""

from __future__ import annotations

import logging
import re
from collections.abc import Callable
from typing import Final

logger = logging.getLogger(__name__)

SERVER: Final = "foxglove"
"""Name of the server's logger."""
MOST_KINDS: Final = 32
"""Viewers choose words of some lines, so kinds of lines are bounded too."""


def kind_of(line: str) -> str:
    """A line without what differs from viewer to viewer: words with digits."""
    return re.sub(r"\S*\d\S*", "...", line)


class ViewerLog(logging.Handler):
    """Stands between the server's logger and all others from `open` to `close`. count: called for every warning."""

    def __init__(self, count: Callable[[], object]) -> None:
        super().__init__()
        self._count = count
        self._kinds: set[str] = set()

    def open(self) -> None:
        """Take the server's lines."""
        server = logging.getLogger(SERVER)
        server.addHandler(self)
        server.propagate = False

    def close(self) -> None:
        """Leave the server's lines to others again; harmless when called twice."""
        server = logging.getLogger(SERVER)
        if self in server.handlers:
            server.removeHandler(self)
            server.propagate = True
        super().close()

    def emit(self, record: logging.LogRecord) -> None:
        """Pass a line on, unless one of its kind was passed on before. Called under the handler's lock."""
        line = record.getMessage()
        if record.levelno < logging.WARNING:
            logger.log(record.levelno, "%s", line)
            return
        self._count()
        kind = kind_of(line)
        if kind not in self._kinds and len(self._kinds) < MOST_KINDS:
            self._kinds.add(kind)
            logger.log(record.levelno, "%s (more of this kind are only counted)", line)
