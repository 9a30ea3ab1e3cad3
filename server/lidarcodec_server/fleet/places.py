"""Places: limits the number of streams, so that no vehicle can take all places.

Each vehicle has a limit. When all places are taken, a new stream replaces one whose publisher is gone. Otherwise a
stream with statuses replaces one that never sent a status. Otherwise it replaces a stream of the vehicle with the most
streams. A refused stream waits for room, and the log and the metrics report it.
"""

from __future__ import annotations

import logging
import time
from collections import Counter
from typing import TYPE_CHECKING

from lidarcodec.transport.keys import StreamKeys
from lidarcodec_server.limits import SparseLog

if TYPE_CHECKING:
    from lidarcodec_server.fleet.fleet import Stream

logger = logging.getLogger(__name__)

MAX_WAITING = 1024
"""Most refused streams that wait for room."""
MUTE_S = 5.0
"""Longest time until the first status of a stream."""
MAX_COUNTED = 64
"""Number of vehicles whose refused streams are counted by vehicle."""


class Places:
    """Finds room, and keeps the streams that wait for it. Not thread-safe: `Fleet` holds a lock.

    waiting: refused streams whose publishers are still online as far as is known; oldest first
    left_out: how often a stream was refused;  by_vehicle: the same by vehicle, for the first 64 vehicles
    """

    def __init__(self, max_streams: int, max_sensors: int) -> None:
        self._max_streams, self._max_sensors = max_streams, max_sensors
        self._warnings = SparseLog(logger)
        self.waiting: dict[StreamKeys, None] = {}
        self.left_out = 0
        self.by_vehicle: Counter[str] = Counter()

    def __contains__(self, keys: StreamKeys) -> bool:
        return keys in self.waiting

    def take(self, keys: StreamKeys, streams: dict[StreamKeys, Stream], *, tells: bool) -> bool:
        """Whether there is room for a stream. A replaced stream is removed, and waits if its publisher is still online.

        tells: whether it has sent a status
        """
        gives_way = self._room(keys, streams, tells=tells)
        if isinstance(gives_way, bool):
            return gives_way
        del streams[gives_way.keys]
        if gives_way.alive:
            self.wait(gives_way.keys)
        return True

    def wait(self, keys: StreamKeys) -> None:
        """Let a refused stream wait for room, up to a limit for each vehicle and for all."""
        if keys in self.waiting:
            return
        of_it = [one for one in self.waiting if one.vehicle == keys.vehicle]
        if len(of_it) >= self._max_sensors:
            del self.waiting[of_it[0]]
        self.waiting[keys] = None
        if len(self.waiting) > MAX_WAITING:
            most = Counter(one.vehicle for one in self.waiting).most_common(1)[0][0]
            del self.waiting[next(one for one in self.waiting if one.vehicle == most)]

    def leave_out(self, keys: StreamKeys, streams: int) -> None:
        """Count a refused stream, and log it."""
        self.left_out += 1
        if keys.vehicle in self.by_vehicle or len(self.by_vehicle) < MAX_COUNTED:
            self.by_vehicle[keys.vehicle] += 1
        if streams < self._max_streams:
            why = f"its vehicle already has {self._max_sensors} sensors, which is the limit (--max-sensors)"
        else:
            why = f"there are already {self._max_streams} streams, which is the limit (--max-streams)"
        self._warnings.warning("stream %s/%s is not shown: %s", keys.vehicle, keys.sensor, why)
        self.wait(keys)

    def _room(self, keys: StreamKeys, streams: dict[StreamKeys, Stream], *, tells: bool) -> Stream | bool:
        """True: there is room; False: there is none; otherwise the stream to replace."""
        own = [one for one in streams.values() if one.keys.vehicle == keys.vehicle]
        if len(own) >= self._max_sensors:
            return _longest_gone(own) or (tells and _mute(own)) or False
        if len(streams) < self._max_streams:
            return True
        everybody = list(streams.values())
        return _longest_gone(everybody) or (tells and _mute(everybody)) or _of_the_greedy(everybody, len(own)) or False


def _longest_gone(streams: list[Stream]) -> Stream | None:
    return min((one for one in streams if not one.alive), key=lambda one: one.status_s, default=None)


def _mute(streams: list[Stream]) -> Stream | None:
    """The newest of the streams that had time to send a status and never did."""
    before_s = time.monotonic() - MUTE_S
    return next((one for one in reversed(streams) if one.status is None and one.came_s < before_s), None)


def _of_the_greedy(streams: list[Stream], own: int) -> Stream | None:
    """A stream of the vehicle with the most streams, if it has clearly more than the vehicle of the new stream."""
    vehicle, most = Counter(one.keys.vehicle for one in streams).most_common(1)[0]
    if most <= own + 1:
        return None
    theirs = [one for one in streams if one.keys.vehicle == vehicle]
    return _mute(theirs) or theirs[-1]
