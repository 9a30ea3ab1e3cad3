"""Located: where programs that find a sensor in a map say that it is (docs/live.md), for the viewers of its stream.

Any program on the network can say so. What is not a pose, and what too many others say, is dropped. Of what one program
says in a period the newest counts.

>>> data = b'{"stamp_ns": 5, "state": "lost", "map": "town", "frame": "local"}'
>>> located_event("car", data)["state"], located_event("car", b'{"state": "here"}')
('lost', None)
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
import threading
import time
from collections.abc import Callable
from typing import Any, Final

import numpy as np

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
PERIOD_S: Final = 0.1
"""Shortest time between two poses for a viewer."""
MOST_PROGRAMS: Final = 8
FORGET_S: Final = 10.0
WORD: Final = 64
NOT_RIGID: Final = 1e-3
"""Products of the rows of a rotation may be off by so much."""
Tell = Callable[[list[dict[str, Any]]], object]


class Located:
    """Listens between `start` and `close`, which may wait for the network, each in a thread of its own.

    tell: gets the events of a period together, in the event loop
    """

    def __init__(self, keys: StreamKeys, transport: Transport, loop: asyncio.AbstractEventLoop, tell: Tell) -> None:
        self._keys, self._transport, self._loop, self._tell = keys, transport, loop, tell
        self._lock = threading.Lock()
        self._listener: Closeable | None = None
        self._heard: dict[str, float] = {}
        self._newest: dict[str, bytes] = {}
        self._closed = False
        self._next_s = -math.inf
        self._warnings = SparseLog(logger)

    def start(self) -> None:
        """Listen, unless it is closed already. Raises TransportError."""
        listener = self._transport.listen(self._keys.pose(), self._came)
        with self._lock:
            if not self._closed:
                self._listener = listener
                return
        listener.close()

    def close(self) -> None:
        """Stop."""
        with self._lock:
            self._closed = True
            listener, self._listener = self._listener, None
        if listener is not None:
            listener.close()

    def _came(self, key: str, data: bytes) -> None:
        name, now = key.rpartition("/")[2], time.monotonic()
        with self._lock:
            self._heard = {one: at for one, at in self._heard.items() if now - at < FORGET_S}
            if name not in self._heard and len(self._heard) >= MOST_PROGRAMS:
                self._warnings.warning(
                    "more than %d programs send poses of %s: further ones are ignored", MOST_PROGRAMS, self._keys.prefix
                )
                return
            self._heard[name] = now
            planned = bool(self._newest)
            self._newest[name] = data if len(data) <= MOST_BYTES else b""
        if not planned:
            with contextlib.suppress(RuntimeError):  # the loop is closed: the server has stopped
                self._loop.call_soon_threadsafe(self._plan)

    # --- in the event loop ------------------------------------------------------------------------------------------

    def _plan(self) -> None:
        self._loop.call_at(max(self._loop.time(), self._next_s), self._pass_on)

    def _pass_on(self) -> None:
        with self._lock:
            newest, self._newest = self._newest, {}
            if self._closed:
                return
        self._next_s = self._loop.time() + PERIOD_S
        events = [event for name, data in newest.items() if (event := located_event(name, data)) is not None]
        if len(events) < len(newest):
            self._warnings.warning("a message on %s is not a pose", self._keys.pose())
        if events:
            self._tell(events)


def located_event(receiver: str, data: bytes) -> dict[str, Any] | None:
    """The event of a message on the key `pose`; None if it is not as docs/live.md has it."""
    try:
        fields = read_object(data, MOST_BYTES)
    except JsonRefusedError:
        return None
    stamp, state, town, frame = (fields.get(name) for name in ("stamp_ns", "state", "map", "frame"))
    # A page shows them: nothing in them may break the line or turn it round.
    texts = all(isinstance(one, str) and len(one) <= WORD and one.isprintable() for one in (town, frame))
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
        if not _is_rigid(event["T_world_sensor"]) or min(*event["sigma_m"], *event["sigma_deg"]) < 0:
            return None
    return event


def _is_rigid(numbers: list[float]) -> bool:
    """Whether three rows of a pose, twelve numbers, begin with a rotation.

    >>> _is_rigid([0, -1, 0, 5, 1, 0, 0, 6, 0, 0, 1, 7]), _is_rigid([0.0] * 12)
    (True, False)
    """
    rows = np.array(numbers, np.float64).reshape(3, 4)[:, :3]
    return bool(np.abs(rows @ rows.T - np.eye(3)).max() < NOT_RIGID and np.linalg.det(rows) > 0)


def _numbers(value: Any, count: int) -> list[float] | None:
    if not isinstance(value, list) or len(value) != count:
        return None
    if not all(isinstance(one, int | float) and not isinstance(one, bool) and abs(one) < FARTHEST for one in value):
        return None
    return [float(one) for one in value]
