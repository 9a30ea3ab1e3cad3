"""Fleet: which streams there are, who is alive, and what each said last. Bounded, whatever is on the network.

>>> fleet = Fleet(max_streams=2)
>>> fleet.changed(StreamKeys("car-7", "roof"), alive=True)
True
>>> [(stream.keys.vehicle, stream.alive) for stream in fleet.streams()]
[('car-7', True)]
"""

from __future__ import annotations

import json
import logging
import threading
import time
from dataclasses import dataclass, replace
from typing import Any

from lidarcodec.apps.reports import finite, refuse_constant
from lidarcodec.errors import SettingsError
from lidarcodec.settings import StreamSettings, settings_from
from lidarcodec.transport.keys import StreamKeys

logger = logging.getLogger(__name__)

MAX_STATUS_BYTES = 64 * 1024
MAX_WAITING = 1024
"""Streams left out that are taken when there is room."""
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
    status_s, answer_s: monotonic times of the last status, and of the last answer to a change
    kbps: what was sent, in kbit/s, as the last minute's statuses told it, one a second, oldest first
    """

    keys: StreamKeys
    alive: bool = False
    settings: StreamSettings | None = None
    status: dict[str, Any] | None = None
    status_s: float = float("-inf")
    answer_s: float = float("-inf")
    kbps: tuple[float | None, ...] = ()

    @property
    def stream_id(self) -> str | None:
        """Of the publisher's current start."""
        given = None if self.status is None else self.status.get("stream_id")
        return given if isinstance(given, str) else None


def read_status(data: bytes) -> dict[str, Any] | None:
    """A status; None for what is none."""
    if len(data) > MAX_STATUS_BYTES:
        return None
    try:
        status = json.loads(data, parse_constant=refuse_constant, parse_float=finite)
        data.decode("utf-8").encode("utf-8")
        json.dumps(status, ensure_ascii=False).encode("utf-8")  # a lone surrogate could not be sent on
    except (ValueError, RecursionError):
        return None
    return status if isinstance(status, dict) else None


def number_in(values: Any, name: str) -> float | None:
    """The number of that name in something that a vehicle told; None where there is none."""
    value = values.get(name) if isinstance(values, dict) else None
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < LARGEST:
        return None
    return float(value)


def known_settings(values: Any) -> StreamSettings | None:
    """Settings that a vehicle told; what a newer vehicle has beyond ours is left out. None for what is none."""
    if not isinstance(values, dict):
        return None
    try:
        return settings_from({name: value for name, value in values.items() if name in StreamSettings.model_fields})
    except SettingsError:
        return None


class Fleet:
    """The streams, by name. Thread-safe; every `Stream` handed out is a value of its own."""

    def __init__(self, max_streams: int = 256) -> None:
        self._max = max_streams
        self._lock = threading.Lock()
        self._streams: dict[StreamKeys, Stream] = {}
        self._waiting: dict[StreamKeys, None] = {}  # left out, and still there as far as is known; oldest first
        self.left_out = 0
        """Times that a stream was not taken, because there were too many."""

    def streams(self) -> list[Stream]:
        """All of them, by name."""
        with self._lock:
            return sorted(self._streams.values(), key=lambda one: (one.keys.vehicle, one.keys.sensor))

    def get(self, keys: StreamKeys) -> Stream | None:
        """One of them."""
        with self._lock:
            return self._streams.get(keys)

    def changed(self, keys: StreamKeys, *, alive: bool) -> bool:
        """A publisher came or went. False if there is no room: then its statuses are looked at until there is."""
        with self._lock:
            if not alive:
                self._waiting.pop(keys, None)
            if keys not in self._streams and not (alive and self._room()):
                if alive:
                    self._wait(keys)
                return False
            self._waiting.pop(keys, None)
            self._streams[keys] = replace(self._streams.get(keys, Stream(keys)), alive=alive)
            return True

    def told(self, keys: StreamKeys, data: bytes) -> bool:
        """A status came. True if it is the first one of another start of a publisher that was known, or of one for
        which there was no room before.
        """
        status = read_status(data)
        if status is None:
            return False
        now = time.monotonic()
        with self._lock:
            stream = self._streams.get(keys)
            waited = stream is None and keys in self._waiting and self._has_room()
            if waited:
                del self._waiting[keys]
                stream = Stream(keys, alive=self._room())
            if stream is None:  # only a token makes a stream: a status may be anybody's last word
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

    def _wait(self, keys: StreamKeys) -> None:
        self._waiting[keys] = None
        if len(self._waiting) > MAX_WAITING:
            del self._waiting[next(iter(self._waiting))]

    def _has_room(self) -> bool:
        return len(self._streams) < self._max or not all(one.alive for one in self._streams.values())

    def _room(self) -> bool:
        if len(self._streams) < self._max:
            return True
        gone = [one for one in self._streams.values() if not one.alive]
        if gone:
            del self._streams[min(gone, key=lambda one: one.status_s).keys]
            return True
        self.left_out += 1
        if self.left_out == 1:
            logger.warning("more than %d streams: further ones are left out", self._max)
        return False
