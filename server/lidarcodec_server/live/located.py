"""Located: where programs that find a sensor in a map say that it is (docs/live.md), for the viewers of its stream.

Any program on the network can say so. What is not a pose, what comes too often and what too many others say is dropped.

>>> data = b'{"stamp_ns": 5, "state": "lost", "map": "town", "frame": "local"}'
>>> located_event("car", data)["state"], located_event("car", b'{"state": "here"}')
('lost', None)
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable
from typing import Any, Final

from lidarcodec.settings import is_name
from lidarcodec.transport import Transport
from lidarcodec.transport.base import Closeable
from lidarcodec.transport.keys import StreamKeys
from lidarcodec.untrusted.json import JsonRefusedError, read_object
from lidarcodec_server.limits import SparseLog

logger = logging.getLogger(__name__)

MOST_BYTES: Final = 4096
STATES: Final = ("searching", "tracking", "lost")
FARTHEST: Final = 1e8
"""Largest number of a pose or of a deviation."""
PERIOD_S: Final = 0.02
"""Poses of one program that come sooner after another are dropped."""
MOST_PROGRAMS: Final = 8
FORGET_S: Final = 10.0
WORD: Final = 64
Tell = Callable[[dict[str, Any]], object]


class Located:
    """Listens between `start` and `close`, which may wait for the network. tell: gets the events, in another thread"""

    def __init__(self, keys: StreamKeys, transport: Transport, tell: Tell) -> None:
        self._keys, self._transport, self._tell = keys, transport, tell
        self._listener: Closeable | None = None
        self._heard: dict[str, float] = {}
        self._warnings = SparseLog(logger)

    def start(self) -> None:
        """Listen. Raises TransportError."""
        self._listener = self._transport.listen(self._keys.pose(), self._came)

    def close(self) -> None:
        """Stop."""
        if self._listener is not None:
            self._listener.close()

    def _came(self, key: str, data: bytes) -> None:
        name, now = key.rpartition("/")[2], time.monotonic()
        if now - self._heard.get(name, -math.inf) < PERIOD_S:
            return
        event = located_event(name, data)
        if event is None:
            self._warnings.warning("what came on %s is no pose", self._keys.pose())
            return
        self._heard = {one: at for one, at in self._heard.items() if now - at < FORGET_S}
        if name not in self._heard and len(self._heard) >= MOST_PROGRAMS:
            self._warnings.warning("more than %d programs say where %s is", MOST_PROGRAMS, self._keys.prefix)
            return
        self._heard[name] = now
        self._tell(event)


def located_event(receiver: str, data: bytes) -> dict[str, Any] | None:
    """The event of a message on the key `pose`; None if it is not as docs/live.md has it."""
    try:
        fields = read_object(data, MOST_BYTES)
    except JsonRefusedError:
        return None
    stamp, state, town, frame = (fields.get(name) for name in ("stamp_ns", "state", "map", "frame"))
    texts = all(isinstance(one, str) and len(one) <= WORD for one in (town, frame))
    if not is_name(receiver) or type(stamp) is not int or not 0 <= stamp < 1 << 63 or state not in STATES or not texts:
        return None
    event: dict[str, Any] = {
        "event": "pose", "receiver": receiver, "stamp_ns": stamp, "state": state, "map": town, "frame": frame,
        "T_world_sensor": None, "sigma_m": None, "sigma_deg": None,
    }  # fmt: skip
    if state == "tracking":
        for name, count in (("T_world_sensor", 12), ("sigma_m", 3), ("sigma_deg", 3)):
            event[name] = _numbers(fields.get(name), count)
            if event[name] is None:
                return None
    return event


def _numbers(value: Any, count: int) -> list[float] | None:
    if not isinstance(value, list) or len(value) != count:
        return None
    if not all(isinstance(one, int | float) and not isinstance(one, bool) and abs(one) < FARTHEST for one in value):
        return None
    return [float(one) for one in value]
