"""Adapting: sets the encoder's bitrate from the send times that Flight measures. `ratecontrol.adaptive` has the
rule."""

from __future__ import annotations

import logging
import threading
from typing import Any, Protocol

from lidarcodec.apps.publisher.flight import Flight
from lidarcodec.apps.publisher.path_times import LIMIT_S
from lidarcodec.ratecontrol.adaptive import (
    Landing,
    PathState,
    adapted,
    capacity_kbps,
    elsewhere,
    sustained_kbps,
    target_kbps,
    while_waiting,
)

logger = logging.getLogger(__name__)


class Aimed(Protocol):
    """Anything with a target bitrate: a StreamEncoder, in this process or another."""

    def aim(self, target_kbps: float) -> None: ...


class Adapting:
    """Measures the network with every message, even without a target, so that `auto` starts with a known bitrate.

    `aim` is for one thread; `report` is thread-safe.
    """

    def __init__(self, flight: Flight) -> None:
        self._flight = flight
        self._lock = threading.Lock()
        self._state = PathState()
        self._switches = self._replaced = 0
        self._stalled = False

    def aim(self, encoder: Aimed, replaced: int, *, automatic: bool = True) -> None:
        """Set the encoder's bitrate before a frame. replaced: number of frames replaced so far

        automatic: whether the target is `auto`; otherwise the encoder keeps its own
        """
        landings = self._flight.landings()
        switched, self._switches = self._flight.switches != self._switches, self._flight.switches
        with self._lock:
            if switched:
                self._state = elsewhere(self._state)
            for landing in landings:
                left_out, self._replaced = replaced - self._replaced, replaced
                self._state, _ = adapted(self._state, landing._replace(replaced=left_out))
                self._tell(landing, automatic=automatic)
            encoder.aim(while_waiting(target_kbps(self._state), self._flight.waited_for()))

    def report(self) -> dict[str, Any]:
        """For the status: the capacity that single messages show, and what the path carries for long, in kbit/s, null
        if unknown; and the share of the capacity in use."""
        with self._lock:
            state = self._state
        found, sustained = capacity_kbps(state), sustained_kbps(state)
        return {
            "capacity_kbps": None if found is None else round(found, 1),
            "sustained_kbps": None if sustained is None else round(sustained, 1),
            "share": round(state.share, 3),
        }

    def _tell(self, landing: Landing, *, automatic: bool) -> None:
        """Log one line when messages stop arriving, and one when they arrive again."""
        if landing.landed != self._stalled:
            return
        self._stalled = not landing.landed
        if self._stalled:
            long = landing.send_s >= LIMIT_S  # shorter ones are lost messages, counted as `timeouts`
            level = logging.WARNING if long else logging.DEBUG
            then = "the automatic bitrate falls" if automatic else "meanwhile newer frames replace older ones"
            logger.log(level, "a message did not arrive within %.1f s: %s", landing.send_s, then)
        elif automatic:
            logger.info("messages arrive again: the automatic bitrate rises")
        else:
            logger.info("messages arrive again")


__all__ = ["Adapting", "Aimed"]
