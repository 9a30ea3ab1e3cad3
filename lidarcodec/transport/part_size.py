"""PartSize: how many bytes to ask for at once, so that nothing else on the link waits long for them.

>>> parts = PartSize()
>>> parts.took(parts.bytes, 0.010); parts.bytes   # the shortest round trip so far: nothing was waited for
4506
>>> parts.took(parts.bytes, 0.050); parts.bytes   # the link was busy for 40 ms
4096
"""

from __future__ import annotations

import threading
from typing import Final

MIN_PART: Final = 4096
MAX_PART: Final = 64 * 1024
PART_S: Final = 0.008
"""Time that a part may take on the link: a live message waits at most so long for it."""


class PartSize:
    """The size of the next part. Thread-safe. bytes: what to ask for"""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.lost()

    def lost(self) -> None:
        """There was no answer: begin anew, because the path may be another one."""
        with self._lock:
            self.bytes, self._round_s = MIN_PART, float("inf")

    def took(self, size: int, seconds: float) -> None:
        """A part of this size came. Parts become larger while they take less than PART_S beyond the shortest round
        trip."""
        with self._lock:
            self._round_s = min(self._round_s * 1.01, seconds)
            if seconds - self._round_s > PART_S:
                self.bytes = max(MIN_PART, int(self.bytes / 1.5))
            elif size >= self.bytes:
                self.bytes = min(MAX_PART, int(self.bytes * 1.1) + 1)
