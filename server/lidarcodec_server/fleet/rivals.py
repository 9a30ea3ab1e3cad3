"""Rivals: detects other programs that change the settings of operators, and when to stop sending to a vehicle.

Two servers with settings for one vehicle would overwrite each other without end. So a server that was overridden
several times sends nothing more until one of its operators changes a setting.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

from lidarcodec.settings import StreamSettings
from lidarcodec.transport.keys import StreamKeys
from lidarcodec_server.fleet.desired import in_step

TIMES, WITHIN_S = 3, 600.0
"""A server that was overridden so often within so many seconds sends nothing more."""
TELL_S = 30.0
"""Shortest time between two log lines about one stream."""


class Override(NamedTuple):
    """The changes of another program;  new: whether the log has no recent line about this stream"""

    text: str
    new: bool


class Rivals:
    """Compares the sent settings with those that vehicles report. Thread-safe; it has only streams with settings
    here.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._sent: dict[StreamKeys, dict[str, Any]] = {}
        self._overridden: dict[StreamKeys, deque[float]] = {}
        self._to_tell: dict[StreamKeys, tuple[Override, dict[str, Any]]] = {}
        """With what was sent."""

    def sent(self, keys: StreamKeys, wanted: dict[str, Any]) -> None:
        """A vehicle has accepted the wanted settings."""
        with self._lock:
            self._sent[keys] = wanted
            self._to_tell.pop(keys, None)

    def returned(self, keys: StreamKeys) -> None:
        """A vehicle came back: it may have the settings of its command line."""
        with self._lock:
            self._sent.pop(keys, None)
            self._to_tell.pop(keys, None)

    def forget(self, keys: StreamKeys) -> None:
        """An operator changed or deleted the settings here: earlier changes of others no longer count."""
        with self._lock:
            for one in (self._sent, self._overridden, self._to_tell):
                one.pop(keys, None)

    def told(self, keys: StreamKeys, settings: StreamSettings) -> bool:
        """A vehicle reports its settings. True if another program has just changed them."""
        with self._lock:
            wanted = self._sent.get(keys)
            if wanted is None or in_step(wanted, settings):
                return False
            del self._sent[keys]
            values, now = settings.model_dump(), self._clock()
            times = self._overridden.setdefault(keys, deque(maxlen=TIMES))
            new = not times or now - times[-1] >= TELL_S or len(times) + 1 == TIMES
            times.append(now)
            differ = [
                f"{name} is {values[name]}, not {value}" for name, value in wanted.items() if values[name] != value
            ]
            self._to_tell[keys] = Override(", ".join(differ)[:300], new), wanted
            return True

    def to_tell(self, keys: StreamKeys, wanted: dict[str, Any] | None = None) -> Override | None:
        """The changes of another program that were not reported yet.

        wanted: what operators want now. If that is not what was sent here, another server with the same database has
        sent it: this is no override, and does not count
        """
        with self._lock:
            told, sent = self._to_tell.pop(keys, (None, None))
            if told is None or wanted is None or wanted == sent:
                return told
            if keys in self._overridden:
                self._overridden[keys].pop()
            return None

    def leave_it(self, keys: StreamKeys) -> bool:
        """Whether this server was overridden so often that it should send nothing more."""
        with self._lock:
            times = self._overridden.get(keys)
            return times is not None and len(times) == TIMES and self._clock() - times[0] < WITHIN_S
