"""TurnInbox: the newest message of an inbox; of a turn in parts all of them.

A newer frame or turn replaces what waits, but not the rest of a turn of which a part was taken.
"""

from __future__ import annotations

from collections import deque
from typing import Final

from lidarcodec.apps.mailbox import rest_of_begun
from lidarcodec.settings import MAX_PARTS
from lidarcodec.transport.base import Inbox
from lidarcodec.wire import goes_on

DEPTH: Final = 2 * MAX_PARTS
"""Messages that an inbox holds: the rest of a turn, and the next one."""
MAX_BYTES: Final = 64 * 2**20
"""Most bytes that wait here, beside the newest message. The packets of the longest turn have 2.5 MB."""


class TurnInbox:
    """Takes messages of an inbox that holds DEPTH of them. For one thread."""

    def __init__(self, inbox: Inbox) -> None:
        self._inbox: Final = inbox
        self._waiting: deque[bytes] = deque(maxlen=DEPTH)

    def receive(self) -> bytes | None:
        """Wait for a message; None once the inbox is closed."""
        if not self._waiting:
            data = self._inbox.receive()
            if data is None:
                return None
            self._add(data)
        while (data := self._inbox.receive_now()) is not None:
            self._add(data)
        return self._waiting.popleft()

    def _add(self, data: bytes) -> None:
        if not goes_on(data):
            begun = rest_of_begun(self._waiting, goes_on)
            while len(self._waiting) > begun:
                self._waiting.pop()
        while self._waiting and sum(map(len, self._waiting)) + len(data) > MAX_BYTES:
            self._waiting.popleft()
        self._waiting.append(data)
