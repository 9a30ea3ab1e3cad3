"""Fleet: the known streams, whether each is alive, and its last status. Memory is bounded for any network input.

>>> fleet = Fleet(max_streams=2)
>>> fleet.changed(StreamKeys("car-7", "roof"), alive=True)
True
>>> [(stream.keys.vehicle, stream.alive) for stream in fleet.streams()]
[('car-7', True)]
"""

from __future__ import annotations

import logging
import threading
import time
from dataclasses import dataclass, field, replace
from typing import Any

from lidarcodec.settings import AUTO, StreamSettings
from lidarcodec.transport.keys import StreamKeys
from lidarcodec.untrusted.json import JsonRefusedError
from lidarcodec_server.fleet.places import Places
from lidarcodec_server.limits import SparseLog
from lidarcodec_server.told import known_settings, read_status

logger = logging.getLogger(__name__)

MINUTE = 60
"""Number of statuses in a minute."""
LARGEST = 1e15
"""Larger numbers in a status are not believed."""
ANSWER_HOLDS_S = 3.0
"""For so long the answer to a change wins over a status: a status sent before the change may arrive after the
answer."""
BOTH_HOLDS_S = 10.0
"""After so long without a status of the other one, there is one publisher again."""
PUBLISHERS = 8
"""Number of earlier publishers of a stream that are remembered."""


@dataclass(frozen=True)
class Stream:
    """What the server knows of one stream.

    settings: settings in force, None before the vehicle reported any;  status: its last status
    came_s, status_s, answer_s: monotonic times at which the stream was accepted, of its last status, and of the last
                                answer to a change
    kbps: sent bitrate in kbit/s from the statuses of the last minute, one a second, oldest first
    before: ids of publishers before the present one, newest last;  both_s: monotonic time at which one of them last
            came back, which it does only where two publishers have the same name
    """

    keys: StreamKeys
    alive: bool = False
    settings: StreamSettings | None = None
    status: dict[str, Any] | None = None
    came_s: float = field(default_factory=time.monotonic)
    status_s: float = float("-inf")
    answer_s: float = float("-inf")
    kbps: tuple[float | None, ...] = ()
    before: tuple[str, ...] = ()
    both_s: float = float("-inf")

    @property
    def stream_id(self) -> str | None:
        """Id of the stream; it is new at each start of the publisher."""
        given = None if self.status is None else self.status.get("stream_id")
        return given if isinstance(given, str) else None

    @property
    def of_two(self) -> bool:
        """Whether two publishers send under this name."""
        return self.alive and time.monotonic() - self.both_s < BOTH_HOLDS_S

    def with_publisher(self, before: str | None, now_s: float) -> Stream:
        """After a new status. before: the stream id of the status before it"""
        if before is None or before == self.stream_id:
            return self
        both_s = now_s if self.stream_id in self.before else self.both_s
        return replace(self, before=(*self.before, before)[-PUBLISHERS:], both_s=both_s)

    @property
    def codec(self) -> str | None:
        """The codec in force, from the last status. Before the first status: the one in the settings, which may be
        `auto`.
        """
        if self.settings is None:
            return None
        given = (self.status or {}).get("codec")
        return given if self.settings.codec == AUTO and isinstance(given, str) else self.settings.codec


def number_in(values: Any, name: str) -> float | None:
    """The number of that name in a JSON object of a vehicle; None if it has none."""
    value = values.get(name) if isinstance(values, dict) else None
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < LARGEST:
        return None
    return float(value)


class Fleet:
    """The streams, by name. Thread-safe; every returned `Stream` is a copy."""

    def __init__(self, max_streams: int = 256, max_sensors: int = 16) -> None:
        """max_streams: most streams at once;  max_sensors: most streams of one vehicle"""
        self._lock = threading.Lock()
        self._streams: dict[StreamKeys, Stream] = {}
        self._places = Places(max_streams, max_sensors)
        self.refused = self.dropped = 0
        """Number of invalid statuses, and number of unknown or invalid fields in the others."""
        self._warnings = SparseLog(logger)

    def streams(self) -> list[Stream]:
        """All streams, sorted by name."""
        with self._lock:
            return sorted(self._streams.values(), key=lambda one: (one.keys.vehicle, one.keys.sensor))

    def get(self, keys: StreamKeys) -> Stream | None:
        """One stream; None if it is unknown."""
        with self._lock:
            return self._streams.get(keys)

    def left_out(self) -> tuple[int, dict[str, int]]:
        """How often a stream was refused because there were too many; and for some vehicles, how often for each."""
        with self._lock:
            return self._places.left_out, dict(self._places.by_vehicle)

    def waiting(self) -> dict[str, list[StreamKeys]]:
        """The streams that wait for room, by vehicle; at most as many of each vehicle as it may have sensors."""
        found: dict[str, list[StreamKeys]] = {}
        with self._lock:
            for keys in self._places.waiting:
                found.setdefault(keys.vehicle, []).append(keys)
        return found

    def changed(self, keys: StreamKeys, *, alive: bool) -> bool:
        """A publisher came or went. False if there is no room; its statuses are then read until there is."""
        with self._lock:
            if not alive:
                self._places.waiting.pop(keys, None)
            if keys not in self._streams:
                if not alive:
                    return False
                if not self._places.take(keys, self._streams, tells=False):
                    self._places.leave_out(keys, len(self._streams))
                    return False
            self._places.waiting.pop(keys, None)
            self._streams[keys] = replace(self._streams.get(keys) or Stream(keys), alive=alive)
            return True

    def told(self, keys: StreamKeys, data: bytes) -> bool:
        """A status arrived. True if it is the first status after a restart of a known publisher, or the first of a
        publisher for which there is room only now.
        """
        with self._lock:
            if keys not in self._streams and keys not in self._places:
                return False  # only a liveliness token adds a stream: a status may come from a publisher that is gone
        try:
            status, dropped = read_status(data)
        except JsonRefusedError as error:
            self.refused += 1
            self._warnings.warning("cannot read a status of %s: %s", keys.prefix, error)
            return False
        now = time.monotonic()
        with self._lock:
            self.dropped += dropped
            stream = self._streams.get(keys)
            waited = stream is None and keys in self._places and self._places.take(keys, self._streams, tells=True)
            if waited:
                del self._places.waiting[keys]
                stream = Stream(keys, alive=True)
            if stream is None:
                return False
            settings = known_settings(status.get("settings"))
            if settings is None or now - stream.answer_s < ANSWER_HOLDS_S:
                settings = stream.settings
            kbps = (*stream.kbps, number_in(status, "kbps"))[-MINUTE:]
            new = replace(stream, status=status, settings=settings, status_s=now, kbps=kbps)
            new = new.with_publisher(stream.stream_id, now)
            self._streams[keys] = new
            return waited or (stream.stream_id is not None and new.stream_id != stream.stream_id)

    def answered(self, keys: StreamKeys, settings: StreamSettings) -> None:
        """A vehicle answered with its settings in force."""
        with self._lock:
            if keys in self._streams:
                self._streams[keys] = replace(self._streams[keys], settings=settings, answer_s=time.monotonic())
