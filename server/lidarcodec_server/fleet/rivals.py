"""Rivals: whether somebody else changes what operators of this server set, and when to leave a vehicle to them.

Two servers with settings for one vehicle would send theirs at each of its returns, for ever. So a server that was
overridden several times sends no more until one of its operators changes something.
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
"""Overridden so often in so long, a server sends no more."""
TELL_S = 30.0
"""The logs hear of one stream at most so often."""


class Override(NamedTuple):
    """What somebody else changed;  new: the logs have not heard of this stream lately"""

    text: str
    new: bool


class Rivals:
    """What was sent to vehicles, compared with what they tell. Thread-safe; no more streams than have settings here."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._sent: dict[StreamKeys, dict[str, Any]] = {}
        self._overridden: dict[StreamKeys, deque[float]] = {}
        self._to_tell: dict[StreamKeys, Override] = {}

    def sent(self, keys: StreamKeys, wanted: dict[str, Any]) -> None:
        """A vehicle has what is wanted of it."""
        with self._lock:
            self._sent[keys] = wanted
            self._to_tell.pop(keys, None)

    def returned(self, keys: StreamKeys) -> None:
        """A vehicle came back: it may have the settings of its command line."""
        with self._lock:
            self._sent.pop(keys, None)
            self._to_tell.pop(keys, None)

    def forget(self, keys: StreamKeys) -> None:
        """An operator set something here, or wants nothing any more: what others did before does not count."""
        with self._lock:
            for one in (self._sent, self._overridden, self._to_tell):
                one.pop(keys, None)

    def told(self, keys: StreamKeys, settings: StreamSettings) -> bool:
        """A vehicle tells its settings. True if somebody else just changed them."""
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
            self._to_tell[keys] = Override(", ".join(differ)[:300], new)
            return True

    def to_tell(self, keys: StreamKeys) -> Override | None:
        """What somebody else changed and nobody was told of yet."""
        with self._lock:
            return self._to_tell.pop(keys, None)

    def leave_it(self, keys: StreamKeys) -> bool:
        """Whether others override this server so often that it had better send nothing."""
        with self._lock:
            times = self._overridden.get(keys)
            return times is not None and len(times) == TIMES and self._clock() - times[0] < WITHIN_S
