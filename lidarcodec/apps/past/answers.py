"""Answers: a vehicle's answers to questions about what it kept (docs/live.md, "The past").

Parts of pieces are sent between the live messages, and an answer waits for such a gap, for a fifth of a second at most.
It then has as many bytes as arrive before the next live message is due. Where that is not known, or no gap comes, it
has a few kilobytes, and a live message behind it is later by so much.

An answer is a JSON object, as on the control keys, except for the bytes of a piece: these begin with PART, then the
time waited in us as u32, little endian.
"""

from __future__ import annotations

import struct
import time
from collections.abc import Callable
from typing import Any, Final, Protocol

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

PART: Final = 1
HEAD: Final = struct.Struct("<BI")
WAIT_S: Final = 0.2
TICK_S, LONGEST_TICK_S = 0.001, 0.005
"""A waiting answer looks at the link at such intervals: a live message may be earlier or later than predicted."""
LISTS_PER_S, LISTS_AT_ONCE = 10.0, 20
"""Rate limit of questions that read files, and of marks, for all clients together; and another such limit of searches
for pieces that were not listed lately."""


class Link(Protocol):
    """The link of a live stream."""

    @property
    def busy(self) -> bool:
        """Whether a live message is on its way."""

    def room(self, most: int, least: int) -> tuple[float, int] | None:
        """How long to wait for a gap, and if that is 0, how many bytes of `most` are to be sent. None: not known.

        least: bytes that hold a live message up for so short a time that they may be sent before it
        """


class Answers:
    """Answers about what one keeper kept.

    link: gives the link of the live stream; None while there is none
    take: takes one from the rate limit; gives the seconds until the next one, 0 if this one is allowed
    """

    def __init__(
        self, kept: Kept, keys: StreamKeys, link: Callable[[], Link | None], take: Callable[[], float], once: Once
    ) -> None:
        self._kept, self._keys, self._link, self._take, self._once = kept, keys, link, take, once
        self._search = Allowance(LISTS_PER_S, LISTS_AT_ONCE).take
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
        """Raises GoneError, SettingsError, TooOftenError."""
        offset, size = _whole(query, "offset"), _whole(query, "bytes")
        most = _whole(query, "most") if "most" in query else size
        length = min(max(size, most), MAX_PART)
        data = self._kept.part(
            _text(query, "piece"), _whole(query, "at_ns"), offset, length, lambda: self._allow(self._search)
        )
        begin = time.monotonic()
        room = self._wait_for_room(max(1, min(most, len(data))), size, begin + WAIT_S)
        data = data[: size if room is None else room]
        return HEAD.pack(PART, int(1e6 * (time.monotonic() - begin))) + data

    def _wait_for_room(self, most: int, least: int, end_s: float) -> int | None:
        """Wait for a gap between live messages. The bytes that fit into it; None: that is not known, or none came."""
        while True:
            link, left_s = self._link(), end_s - time.monotonic()
            if link is None or left_s <= 0.0:
                return None
            room = link.room(most, least)
            if room is None:
                if not link.busy:
                    return None
                wait_s = TICK_S
            else:
                wait_s, size = room
                if size:
                    return size
            time.sleep(min(max(wait_s, TICK_S), LONGEST_TICK_S, left_s))

    def _tell(self, query: dict[str, Any]) -> dict[str, Any]:
        ask = query.get("ask", "spans")
        self._allow(self._take)
        if ask == "spans":
            spans = [list(span) for span in self._kept.spans()]
            return {"spans": spans, "marks": [_about(mark) for mark in self._kept.marks], "totals": self._kept.totals}
        if ask == "pieces":
            pieces, more = self._kept.pieces(time_ns_of(query.get("from"), "from"), time_ns_of(query.get("to"), "to"))
            told = [piece.about() for piece in pieces]
            return {"pieces": told, "more": more, "until_ns": self._kept.until_ns()}
        raise SettingsError("ask must be spans, pieces or part", "ask")

    def _mark(self, query: dict[str, Any]) -> dict[str, Any]:
        self._allow(self._take)
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

    def _allow(self, take: Callable[[], float]) -> None:
        """Raises and counts TooOftenError if a rate limit is reached."""
        retry_s = take()
        if retry_s:
            error = TooOftenError("kept data is requested", retry_s)
            self._once.add("questions refused", error)
            raise error


def answers_of(keeper: Keeper, link: Callable[[], Link | None]) -> Answers:
    """Answers about what a keeper kept; it counts refused questions. link: gives that of the live stream"""
    return Answers(keeper.kept, keeper.keys, link, Allowance(LISTS_PER_S, LISTS_AT_ONCE).take, keeper.once)


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
