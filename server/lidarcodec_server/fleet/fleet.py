"""Fleet: the known streams, which are alive, and their last status. Bounded for any input from the network.

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
"""Statuses in a minute."""
LARGEST = 1e15
"""A figure beyond this is a mistake, or a joke."""
ANSWER_HOLDS_S = 3.0
"""A status that left the vehicle before a change may arrive behind the answer to it: so long the answer is believed."""


@dataclass(frozen=True)
class Stream:
    """What is known of one stream.

    settings: those in force, None before the vehicle said;  status: its last status
    came_s, status_s, answer_s: monotonic times at which it was taken, of the last status, and of the last answer to a
                                change
    kbps: what was sent, in kbit/s, as the last minute's statuses told it, one a second, oldest first
    """

    keys: StreamKeys
    alive: bool = False
    settings: StreamSettings | None = None
    status: dict[str, Any] | None = None
    came_s: float = field(default_factory=time.monotonic)
    status_s: float = float("-inf")
    answer_s: float = float("-inf")
    kbps: tuple[float | None, ...] = ()

    @property
    def stream_id(self) -> str | None:
        """Of the publisher's current start."""
        given = None if self.status is None else self.status.get("stream_id")
        return given if isinstance(given, str) else None

    @property
    def codec(self) -> str | None:
        """In force, as the vehicle told; before it did, the one that was asked for, which may be `auto`."""
        if self.settings is None:
            return None
        given = (self.status or {}).get("codec")
        return given if self.settings.codec == AUTO and isinstance(given, str) else self.settings.codec


def number_in(values: Any, name: str) -> float | None:
    """The number of that name in something that a vehicle told; None where there is none."""
    value = values.get(name) if isinstance(values, dict) else None
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < LARGEST:
        return None
    return float(value)


class Fleet:
    """The streams, by name. Thread-safe; every `Stream` handed out is a value of its own."""

    def __init__(self, max_streams: int = 256, max_sensors: int = 16) -> None:
        """max_streams: that are known at once;  max_sensors: of one vehicle"""
        self._lock = threading.Lock()
        self._streams: dict[StreamKeys, Stream] = {}
        self._places = Places(max_streams, max_sensors)
        self.refused = self.dropped = 0
        """Statuses that are none, and fields of others that are not known or not what they should be."""
        self._warnings = SparseLog(logger)

    def streams(self) -> list[Stream]:
        """All of them, by name."""
        with self._lock:
            return sorted(self._streams.values(), key=lambda one: (one.keys.vehicle, one.keys.sensor))

    def get(self, keys: StreamKeys) -> Stream | None:
        """One of them."""
        with self._lock:
            return self._streams.get(keys)

    def left_out(self) -> tuple[int, dict[str, int]]:
        """Times that a stream was not taken, because there were too many; and of which vehicles, for some of them."""
        with self._lock:
            return self._places.left_out, dict(self._places.by_vehicle)

    def waiting(self) -> dict[str, list[StreamKeys]]:
        """The streams of each vehicle that wait for room, where any do: at most as many as it may have sensors."""
        found: dict[str, list[StreamKeys]] = {}
        with self._lock:
            for keys in self._places.waiting:
                found.setdefault(keys.vehicle, []).append(keys)
        return found

    def changed(self, keys: StreamKeys, *, alive: bool) -> bool:
        """A publisher came or went. False if there is no room: then its statuses are looked at until there is."""
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
        """A status came. True if it is the first one of another start of a publisher that was known, or of one for
        which there was no room before.
        """
        with self._lock:
            if keys not in self._streams and keys not in self._places:
                return False  # only a token makes a stream: a status may be anybody's last word
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
            self._streams[keys] = new
            return waited or (stream.stream_id is not None and new.stream_id != stream.stream_id)

    def answered(self, keys: StreamKeys, settings: StreamSettings) -> None:
        """A vehicle told the settings in force, asked."""
        with self._lock:
            if keys in self._streams:
                self._streams[keys] = replace(self._streams[keys], settings=settings, answer_s=time.monotonic())
