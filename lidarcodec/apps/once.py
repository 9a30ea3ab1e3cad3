"""Once: log an error the first time, count it every time."""

from __future__ import annotations

import logging
import threading
from collections import Counter

MAX_CAUSES = 64


class Once:
    """Counts errors, with one WARNING for each kind. Thread-safe."""

    def __init__(self, logger: logging.Logger) -> None:
        self._logger = logger
        self._lock = threading.Lock()
        self._causes: set[tuple[str, type[BaseException]]] = set()
        self.counts: Counter[str] = Counter()

    def add(self, what: str, error: BaseException) -> None:
        """Count `what`, and log it with the error if this kind of error is new for it."""
        cause = (what, type(error))
        with self._lock:
            self.counts[what] += 1
            new = cause not in self._causes and len(self._causes) < MAX_CAUSES
            if new:
                self._causes.add(cause)
        if new:
            self._logger.warning("%s: %s (more of this kind are only counted)", what, error)
