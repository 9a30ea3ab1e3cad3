"""Desk: a publisher's handlers for the network: joining and leaving receivers, arrivals, reports, control queries."""

from __future__ import annotations

import time
from typing import Any, Protocol, Unpack, cast

from lidarcodec.apps.clocks import Clock
from lidarcodec.apps.control import Applied
from lidarcodec.apps.once import Once
from lidarcodec.apps.publisher.arrivals import listen_for_arrivals
from lidarcodec.apps.publisher.flight import Flight
from lidarcodec.apps.publisher.status import StatusBoard
from lidarcodec.settings import SettingChanges, StreamSettings
from lidarcodec.transport import Transport
from lidarcodec.transport.allowance import Allowance
from lidarcodec.transport.answering import TooOftenError, answered
from lidarcodec.transport.base import Closeable
from lidarcodec.transport.keys import StreamKeys

CHANGES_PER_S, CHANGES_AT_ONCE = 5.0, 20
"""Rate limit of changes of settings, for all clients together."""
QUESTIONS_PER_S, QUESTIONS_AT_ONCE = 50.0, 100
"""Rate limit of queries for settings and status, for all clients together."""
STATUS_HOLDS_S = 0.1
"""Shortest interval at which the status is computed; queries in between get the last one."""


class Controlled(Protocol):
    """The object that control queries act on: a Publisher."""

    @property
    def settings(self) -> StreamSettings: ...

    def status(self) -> dict[str, Any]: ...

    def change(self, /, **changes: Unpack[SettingChanges]) -> Applied: ...

    def reset(self) -> Applied: ...

    def request_key(self) -> bool: ...

    @property
    def next_index(self) -> int: ...


class Desk:
    """Forwards data from the network. Called in threads of the transport, so it must be fast."""

    def __init__(
        self, publisher: Controlled, keys: StreamKeys, flight: Flight, board: StatusBoard, clock: Clock, once: Once
    ) -> None:
        """once: counts and logs refused queries"""
        self._once = once
        self._changes = Allowance(CHANGES_PER_S, CHANGES_AT_ONCE)
        self._questions = Allowance(QUESTIONS_PER_S, QUESTIONS_AT_ONCE)
        self._status: dict[str, Any] = {}
        self._status_s = float("-inf")
        self._publisher, self._keys = publisher, keys
        self._flight, self._board, self._clock = flight, board, clock

    def declare(self, transport: Transport) -> list[Closeable]:
        """Declare subscribers and queryables."""
        keys = self._keys
        return [
            *listen_for_arrivals(transport, keys, self._flight, self._publisher.request_key),
            transport.listen(keys.report(), self._reported),
            transport.answer(keys.control_get, answered(self._get)),
            transport.answer(keys.control_set, answered(self._set)),
            transport.answer(keys.control_reset, answered(self._reset)),
            transport.answer(keys.control_keyframe, answered(self._keyframe)),
        ]

    def _reported(self, key: str, data: bytes) -> None:
        name = key.rpartition("/")[2]
        rtt_ms = self._board.report(name, data, self._flight.standing(name))
        if rtt_ms is not None:
            self._flight.round_trip(name, rtt_ms / 1e3)

    def _get(self, query: dict[str, Any]) -> dict[str, Any]:
        if "ping" in query:  # read the clock last; also say whether a frame may delay the answer
            return {"ping": query["ping"], "busy": self._flight.busy, "time_ns": self._clock.wall_ns()}
        self._take(self._questions, "questions refused", "settings are asked for")
        if time.monotonic() - self._status_s >= STATUS_HOLDS_S:
            self._status, self._status_s = self._publisher.status(), time.monotonic()
        return {"settings": self._publisher.settings.model_dump(), "status": self._status}

    def _set(self, query: dict[str, Any]) -> dict[str, Any]:
        self._take(self._changes, "changes refused", "settings are changed")
        changes = cast(SettingChanges, {str(field): value for field, value in query.items()})
        return self._publisher.change(**changes).answer()

    def _reset(self, query: dict[str, Any]) -> dict[str, Any]:
        self._take(self._changes, "changes refused", "settings are changed")
        return self._publisher.reset().answer()

    def _keyframe(self, query: dict[str, Any]) -> dict[str, Any]:
        merged = self._publisher.request_key()
        return {"first_frame": self._publisher.next_index, "merged": merged}

    def _take(self, allowance: Allowance, cause: str, what: str) -> None:
        """Raises and counts TooOftenError if the allowance is used up."""
        retry_s = allowance.take()
        if retry_s:
            error = TooOftenError(what, retry_s)
            self._once.add(cause, error)
            raise error
