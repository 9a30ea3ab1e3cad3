"""Refusals: audit entries of operators' requests above their rate limit. Each client has one entry a minute, with the
number of its requests, so that a client that keeps sending requests cannot fill the database.
"""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

from lidarcodec_server.store.store import Store

if TYPE_CHECKING:
    from lidarcodec_server.operations import Operation

MINUTE_S: Final = 60.0
WRITE_S: Final = 5.0
"""Shortest time between two updates of the number in an entry. It is also updated when the log is read and when the
server stops."""
MAX_CLIENTS: Final = 1024
"""Number of clients with an open entry; without tokens a client is an address."""


@dataclass
class _Counted:
    entry: int
    began_s: float
    written_s: float
    requests: int = 1
    actions: set[str] = field(default_factory=set)
    written: int = 1

    def about(self) -> dict[str, Any]:
        return {"requests": self.requests, "actions": sorted(self.actions)}


class Refusals:
    """Writes entries of refusals, and counts further ones. Thread-safe; blocks while the store works."""

    def __init__(self, store: Store, clock: Callable[[], float] = time.monotonic) -> None:
        self._store, self._clock = store, clock
        self._lock = threading.Lock()
        self._counted: OrderedDict[str, _Counted] = OrderedDict()

    def enter(self, operation: Operation) -> None:
        """Write an entry for a refused request, or count it in its client's entry of the same minute.

        Raises StoreError.
        """
        who, now_s = operation.client.name, self._clock()
        with self._lock:
            known = self._counted.get(who)
            if known is not None and now_s - known.began_s < MINUTE_S:
                known.requests += 1
                known.actions.add(operation.action)
                if now_s - known.written_s >= WRITE_S:
                    self._write(known, now_s)
                return
            if known is not None:
                self._write(known, now_s)
            about = {"requests": 1, "actions": [operation.action]}
            entry = self._store.note(
                operation.keys, who, operation.action, about, result="refused", reason=operation.reason
            )
            self._counted[who] = _Counted(entry, now_s, now_s, actions={operation.action})
            self._counted.move_to_end(who)
            if len(self._counted) > MAX_CLIENTS:
                self._write(self._counted.popitem(last=False)[1], now_s)

    def write(self) -> None:
        """Write all present numbers to the store.

        Raises StoreError.
        """
        with self._lock:
            for known in self._counted.values():
                self._write(known, self._clock())

    def _write(self, known: _Counted, now_s: float) -> None:
        if known.written != known.requests:
            self._store.recount(known.entry, known.about())
            known.written, known.written_s = known.requests, now_s
