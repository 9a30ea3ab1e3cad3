"""Spans: what vehicles keep, as each told it last. The vehicle is asked, if there is a place for the question."""

from __future__ import annotations

import json
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from lidarcodec.errors import LidarCodecError
from lidarcodec.recording.marks import MAX_MARKS, Mark
from lidarcodec.transport import Transport
from lidarcodec.transport.keys import StreamKeys
from lidarcodec.untrusted.json import read_object
from lidarcodec_server.limits import Looks
from lidarcodec_server.past.marked import MAX_ANSWER

ASKED: Final = 4
"""Most vehicles that are asked at once."""
AWAY_ASKED: Final = 1
"""Most streams that are away and are asked at once. Each may take the whole time for an answer, but it may come: a
vehicle answers about what it kept also while a sensor has failed."""
MAX_SPANS: Final = 64
MAX_STREAMS: Final = 256
"""Most streams whose last answer is remembered; the one that told it the longest ago is forgotten."""


@dataclass(frozen=True)
class Told:
    """What a vehicle keeps. at_s: when it told that, on the monotonic clock"""

    spans: list[tuple[int, int]]
    marks: list[Mark]
    at_s: float


class Spans:
    """Asks vehicles what they keep, and remembers their answers. Thread-safe.

    transport: gives the network session, or raises TransportError while there is none
    answer_s:  longest wait for an answer
    """

    def __init__(self, transport: Callable[[], Transport], answer_s: float) -> None:
        self._transport, self._answer_s = transport, answer_s
        self._there, self._away = Looks(ASKED), Looks(AWAY_ASKED)
        self._lock = threading.Lock()
        self._told: OrderedDict[StreamKeys, Told] = OrderedDict()

    def told(self, keys: StreamKeys, *, alive: bool) -> Told | None:
        """What a vehicle tells now, or told last; None if it never did. alive: whether its stream is there

        Raises TransportError.
        """
        places = self._there if alive else self._away
        with places.look(keys) as may:
            fresh = self._ask(keys) if may else None
        with self._lock:
            if fresh is not None:
                self._told[keys] = fresh
                self._told.move_to_end(keys)
                while len(self._told) > MAX_STREAMS:
                    self._told.popitem(last=False)
            return self._told.get(keys)

    def _ask(self, keys: StreamKeys) -> Told | None:
        """The answer of a vehicle; None if there is none that can be read."""
        data = self._transport().ask(keys.past, json.dumps({"ask": "spans"}).encode(), self._answer_s)
        if data is None:
            return None
        try:
            told = read_object(data, MAX_ANSWER)
            spans = [_span(*span) for span in told["spans"][-MAX_SPANS:]]
            marks = [_mark(mark) for mark in told["marks"][:MAX_MARKS]]
        except (LidarCodecError, KeyError, TypeError, ValueError):
            return None
        return Told(spans, marks, time.monotonic())


def _span(begin: Any, end: Any) -> tuple[int, int]:
    """Raises ValueError for anything else than a span."""
    if type(begin) is not int or type(end) is not int or not 0 <= begin <= end < 2**63:
        raise ValueError("no span")
    return begin, end


def _mark(told: dict[str, Any]) -> Mark:
    """Raises KeyError, TypeError, ValueError, SettingsError for anything else than a mark."""
    begin, end = _span(told["from_ns"], told["to_ns"])
    return Mark(str(told["name"]), begin, end, str(told["reason"]), str(told["by"]), 0)
