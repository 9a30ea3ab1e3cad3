"""Answers: a vehicle's answers to questions about what it kept (docs/live.md, "The past").

Parts of pieces are sent between the live messages: an answer waits until the link carries no live message, for a
fifth of a second at most, and then takes a few kilobytes of it. A live message behind it is later by so much.

An answer is a JSON object, as on the control keys, except for the bytes of a piece: these begin with PART, then the
time waited in us as u32, little endian.
"""

from __future__ import annotations

import logging
import struct
import time
from collections.abc import Callable
from typing import Any, Final

from lidarcodec.apps.once import Once
from lidarcodec.apps.past.keeper import Keeper
from lidarcodec.apps.past.kept import Kept
from lidarcodec.errors import LidarCodecError, SettingsError
from lidarcodec.recording.marks import Mark
from lidarcodec.transport import Transport
from lidarcodec.transport.allowance import Allowance
from lidarcodec.transport.answering import TooOftenError, answered, object_of
from lidarcodec.transport.base import Closeable
from lidarcodec.transport.keys import StreamKeys
from lidarcodec.transport.part_size import MAX_PART
from lidarcodec.untrusted.times import time_ns_of

logger = logging.getLogger(__name__)

PART: Final = 1
HEAD: Final = struct.Struct("<BI")
WAIT_S: Final = 0.2
TICK_S: Final = 0.001
LISTS_PER_S, LISTS_AT_ONCE = 10.0, 20
"""Rate limit of questions that read files, and of marks, for all clients together."""


class Answers:
    """Answers about what one keeper kept.

    busy: whether a live message is on its way
    take: takes one from the rate limit; gives the seconds until the next one, 0 if this one is allowed
    """

    def __init__(
        self, kept: Kept, keys: StreamKeys, busy: Callable[[], bool], take: Callable[[], float], once: Once
    ) -> None:
        self._kept, self._keys, self._busy, self._take, self._once = kept, keys, busy, take, once
        self._told = answered(self._tell)

    def declare(self, transport: Transport) -> list[Closeable]:
        """Declare the queryables."""
        return [
            transport.answer(self._keys.past, self._answer),
            transport.answer(self._keys.past_mark, answered(self._mark)),
        ]

    def _answer(self, data: bytes) -> bytes:
        try:
            query = object_of(data)
            if query.get("ask") == "part":
                return self._part(query)
        except LidarCodecError as error:
            return _refused(error)
        return self._told(data)

    def _part(self, query: dict[str, Any]) -> bytes:
        """Raises GoneError, SettingsError."""
        offset, size = _whole(query, "offset"), _whole(query, "bytes")
        data = self._kept.part(_text(query, "piece"), _whole(query, "at_ns"), offset, min(size, MAX_PART))
        begin = time.monotonic()
        while self._busy() and time.monotonic() - begin < WAIT_S:
            time.sleep(TICK_S)
        return HEAD.pack(PART, int(1e6 * (time.monotonic() - begin))) + data

    def _tell(self, query: dict[str, Any]) -> dict[str, Any]:
        ask = query.get("ask", "spans")
        self._allow()
        if ask == "spans":
            spans = [list(span) for span in self._kept.spans()]
            return {"spans": spans, "marks": [_about(mark) for mark in self._kept.marks], "totals": self._kept.totals}
        if ask == "pieces":
            pieces, more = self._kept.pieces(time_ns_of(query.get("from"), "from"), time_ns_of(query.get("to"), "to"))
            told = [piece.about() for piece in pieces]
            return {"pieces": told, "more": more, "until_ns": self._kept.until_ns()}
        raise SettingsError("ask must be spans, pieces or part", "ask")

    def _mark(self, query: dict[str, Any]) -> dict[str, Any]:
        self._allow()
        if "release" in query:
            return {"released": self._kept.release(_text(query, "release"))}
        mark = Mark(
            _text(query, "name"),
            time_ns_of(query.get("from"), "from"),
            time_ns_of(query.get("to"), "to"),
            str(query.get("reason", "")),
            str(query.get("by", "")),
            time.time_ns(),
        )
        self._kept.mark(mark)
        return {"marked": _about(mark)}

    def _allow(self) -> None:
        """Raises and counts TooOftenError if the rate limit is reached."""
        retry_s = self._take()
        if retry_s:
            error = TooOftenError("the past is asked about", retry_s)
            self._once.add("questions refused", error)
            raise error


def answers_of(keeper: Keeper, busy: Callable[[], bool]) -> Answers:
    """Answers about what a keeper kept; it counts refused questions. busy: whether a live message is on its way"""
    return Answers(keeper.kept, keeper.keys, busy, Allowance(LISTS_PER_S, LISTS_AT_ONCE).take, keeper.once)


def _refused(error: LidarCodecError) -> bytes:
    """An error as an answer."""

    def again(query: dict[str, Any]) -> dict[str, Any]:
        raise error

    return answered(again)(b"{}")


def _about(mark: Mark) -> dict[str, Any]:
    return {"name": mark.name, "from_ns": mark.from_ns, "to_ns": mark.to_ns, "reason": mark.reason, "by": mark.by}


def _whole(query: dict[str, Any], field: str) -> int:
    value = query.get(field)
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 2**63:
        raise SettingsError(f"{field} must be a whole number", field)
    return value


def _text(query: dict[str, Any], field: str) -> str:
    value = query.get(field)
    if not isinstance(value, str) or not 0 < len(value) <= 64:
        raise SettingsError(f"{field} must be a text of 1 to 64 characters", field)
    return value
