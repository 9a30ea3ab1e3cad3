"""The interface of a transport. Frames use `Sender` and `Inbox`, newest only; small events and queries use callbacks.

A transport never receives its own messages. Handlers run in threads of the transport, must be fast and must not raise;
an error in a handler is logged once for each kind, and the transport continues.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from enum import Enum
from typing import Any, Protocol, Self

logger = logging.getLogger(__name__)

MAX_ANSWERS = 64
"""Most answers that `ask_all` gives; further ones are dropped."""
MAX_EVENT_BYTES = 1 << 20
"""Longest small event, query or answer that is handed to a handler; longer ones are dropped and logged once."""

EventHandler = Callable[[str, bytes], None]
"""Takes key and bytes of one small event."""
QueryHandler = Callable[[bytes], bytes]
"""Takes the bytes of a query, gives those of the answer."""
KeyHandler = Callable[[str, bytes], bytes | None]
"""Takes key and bytes of a query, gives those of the answer; None if others may answer it."""
AliveHandler = Callable[[str, bool], None]
"""Takes a token's key, and whether it appeared (True) or disappeared (False)."""
MatchHandler = Callable[[bool], None]
"""Called when the first receiver connects (True) and when the last one disconnects (False)."""


class Priority(Enum):
    """Order of sending on a slow link. Each priority has its own queue on every link."""

    REAL_TIME = "real_time"
    """Arrival reports: a few bytes, sent at once, never behind a frame. If two leave within a millisecond on one
    link, a
    busy machine may drop the second silently. So a program must not wait for a report forever."""
    FRAMES = "frames"
    """Messages: they never block the sender. If one already waits for the link, the next is dropped."""
    EVERY_FRAME = "every_frame"
    """Messages that must not be dropped: `put` waits for a full link; after 5 s Zenoh opens the link again."""
    STATUS = "status"
    """Once a second; dropped when the link is full."""
    BESIDE = "beside"
    """As large as frames and after everything else: never blocks the sender, and never delays a frame."""


class Closeable(Protocol):
    """Something that must be closed. A second `close` does nothing."""

    def close(self) -> None: ...


class Sender(Closeable, Protocol):
    """Puts bytes on one key."""

    @property
    def matching(self) -> bool:
        """Whether anybody else receives this key."""

    def put(self, data: bytes, attachment: bytes | None = None) -> None:
        """Pass the bytes to the network. It never waits for a receiver, and for a full link only with EVERY_FRAME.

        attachment: metadata for other programs; receivers of lidarcodec ignore it
        Raises TransportError if the transport is closed.
        """


class Inbox(Closeable, Protocol):
    """Receives one key and keeps only the newest messages, one or a few: older ones are replaced, never queued."""

    def receive(self) -> bytes | None:
        """Wait for a message and return the oldest that it keeps; None once the inbox or its transport is closed."""

    def receive_now(self) -> bytes | None:
        """The same without waiting; None if there is none."""


class Transport(Closeable, Protocol):
    """A session on a network; a context manager.

    Raises TransportError from every method when the session is closed or a key is not valid.
    """

    @property
    def identity(self) -> str:
        """Unique id of this session on its network, in hexadecimal digits."""

    def sender(self, key: str, priority: Priority, on_match: MatchHandler | None = None) -> Sender:
        """A sender on one key; `on_match` is called when the first receiver connects and the last one disconnects."""

    def inbox(self, key: str, depth: int = 1) -> Inbox:
        """A receiver of one key, of the newest `depth` messages."""

    def listen(self, key: str, handler: EventHandler) -> Closeable:
        """Call the handler for every small event on a key, or key expression (`*` one part, `**` any)."""

    def answer(self, key: str, handler: QueryHandler) -> Closeable:
        """Answer queries on one key."""

    def answer_under(self, expression: str, handler: KeyHandler) -> Closeable:
        """Answer queries on all keys that a key expression covers. Queries with wildcards are dropped."""

    def ask(self, key: str, data: bytes = b"", timeout_s: float = 1.0, *, beside: bool = False) -> bytes | None:
        """The first answer to a query; None if there is none in time. beside: both go after everything else"""

    def ask_all(self, key: str, data: bytes = b"", timeout_s: float = 1.0) -> list[bytes]:
        """The answers of all who answer within the time, at most MAX_ANSWERS; they go after everything else."""

    def token(self, key: str) -> Closeable:
        """Show that this process is alive, until closed, killed or cut off."""

    def watch(self, key: str, handler: AliveHandler) -> Closeable:
        """Call the handler for tokens on a key or key expression: existing ones, own ones too, then changes."""

    def gate(self) -> dict[str, Any] | None:
        """Counts of the gate in front of the TLS port (docs/live.md lists them); None without one."""

    def __enter__(self) -> Self: ...

    def __exit__(self, *exc: object) -> None: ...


class Guard:
    """Calls handlers, and logs their errors, once for each kind, instead of raising them."""

    def __init__(self) -> None:
        self._seen: set[tuple[str, type[BaseException]]] = set()

    def call(self, what: str, handler: Callable[..., object], *values: object) -> object:
        """What the handler returns; None if it raised."""
        try:
            return handler(*values)
        except Exception as error:
            if (what, type(error)) not in self._seen:
                self._seen.add((what, type(error)))
                logger.exception("the handler of %s failed; more failures of this kind are not logged", what)
            return None

    def fits(self, what: str, size: int) -> bool:
        """Whether an event of this size may be delivered; a longer one is logged once per key."""
        if size <= MAX_EVENT_BYTES:
            return True
        if (what, OverflowError) not in self._seen:
            self._seen.add((what, OverflowError))
            logger.warning("dropped %d bytes on %s: small events have at most %d", size, what, MAX_EVENT_BYTES)
        return False
