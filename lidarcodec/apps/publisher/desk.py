"""Desk: a publisher's handlers for the network: joining and leaving receivers, arrivals, reports, control queries."""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Callable
from typing import Any, Protocol, Unpack, cast

from lidarcodec.apps.clocks import Clock
from lidarcodec.apps.control import Applied, asker
from lidarcodec.apps.once import Once
from lidarcodec.apps.publisher.arrivals import listen_for_arrivals
from lidarcodec.apps.publisher.flight import Flight
from lidarcodec.apps.publisher.namesakes import Namesake
from lidarcodec.apps.publisher.status import StatusBoard
from lidarcodec.settings import SettingChanges, StreamSettings
from lidarcodec.transport import Transport
from lidarcodec.transport.allowance import Allowance
from lidarcodec.transport.answering import TooOftenError, answered
from lidarcodec.transport.base import Closeable
from lidarcodec.transport.keys import StreamKeys

logger = logging.getLogger(__name__)

CHANGES_PER_S, CHANGES_AT_ONCE = 5.0, 20
"""Rate limit of changes of settings, for all clients together."""
QUESTIONS_PER_S, QUESTIONS_AT_ONCE = 50.0, 100
"""Rate limit of queries for settings and status, for all clients together."""
STATUS_HOLDS_S = 0.1
"""Shortest interval at which the status is computed; queries in between get the last one."""


TELL_S = 5.0
"""Shortest interval between two lines about settings that came over the network."""


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

    @property
    def stream_id(self) -> int: ...


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
        self._namesake = Namesake(keys, publisher.stream_id)
        self._own: StreamSettings | None = None
        self._untold, self._by = False, ""
        self._told_s = float("-inf")

    def declare(self, transport: Transport) -> list[Closeable]:
        """Declare subscribers and queryables."""
        keys = self._keys
        return [
            *listen_for_arrivals(transport, keys, self._flight, self._publisher.request_key),
            transport.listen(keys.report(), self._reported),
            transport.listen(keys.status, lambda _, data: self._namesake.told(data)),
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
        by = asker(query)
        changes = cast(SettingChanges, {str(field): value for field, value in query.items()})
        return self._applied(by, lambda: self._publisher.change(**changes))

    def _reset(self, query: dict[str, Any]) -> dict[str, Any]:
        self._take(self._changes, "changes refused", "settings are changed")
        return self._applied(asker(query), self._publisher.reset)

    def _applied(self, by: str | None, change: Callable[[], Applied]) -> dict[str, Any]:
        before = self._publisher.settings
        applied = change()
        self._own = self._own or before
        self._untold |= applied.settings != before
        self._by = by or "somebody"
        return applied.answer()

    def tell(self) -> None:
        """Say at the vehicle what was set over the network, because its command line said something else at the start.
        Called every second."""
        now = time.monotonic()
        if not self._untold or self._own is None or now - self._told_s < TELL_S:
            return
        self._untold, self._told_s = False, now
        own, keys = self._own, self._keys
        theirs, ours = differing(self._publisher.settings, own), differing(own, self._publisher.settings)
        if theirs:
            logger.warning(
                "%s/%s: %s set %s over the network, in place of %s. To undo it: \"Return to the vehicle's own\" on "
                "the page, or DELETE /api/v1/streams/%s/%s/settings at the server",
                keys.vehicle, keys.sensor, self._by, theirs, ours, keys.vehicle, keys.sensor,
            )  # fmt: skip
        else:
            logger.warning("%s/%s: %s gave the command line's settings back", keys.vehicle, keys.sensor, self._by)

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


def differing(settings: StreamSettings, others: StreamSettings) -> str:
    """The settings that differ from others, in words for a log.

    >>> differing(StreamSettings(codec="raw", target_kbps=None), StreamSettings(target_kbps=800))
    'codec=raw, no target_kbps'
    """
    ours, theirs = settings.model_dump(), others.model_dump()
    return ", ".join(_said(name, value) for name, value in ours.items() if value != theirs[name])


def _said(name: str, value: Any) -> str:
    if value is None:
        return f"no {name}"
    return f"{name}={value if isinstance(value, str) and value else json.dumps(value)}"
