"""Once: log a cause the first time, count it always."""

from __future__ import annotations

import logging
import threading
from collections import Counter

MAX_CAUSES = 64


class Once:
    """Counts of what went wrong, one WARNING for each kind of it. Thread-safe."""

    def __init__(self, logger: logging.Logger) -> None:
        self._logger = logger
        self._lock = threading.Lock()
        self._causes: set[tuple[str, type[BaseException]]] = set()
        self.counts: Counter[str] = Counter()

    def add(self, what: str, error: BaseException) -> None:
        """Count `what`; say why, unless it happened with this kind of error before."""
        cause = (what, type(error))
        with self._lock:
            self.counts[what] += 1
            new = cause not in self._causes and len(self._causes) < MAX_CAUSES
            if new:
                self._causes.add(cause)
        if new:
            self._logger.warning("%s: %s (more of this kind are only counted)", what, error)
