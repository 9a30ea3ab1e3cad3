"""Marked: fetches the clips of marks that vehicles tell of, so that they are here if the vehicle is lost."""

from __future__ import annotations

import json
import logging
import threading
from collections.abc import Callable
from typing import Any, Final

from lidarcodec.apps.past.plan import Clip
from lidarcodec.errors import LidarCodecError
from lidarcodec.recording.marks import MAX_MARK_NS, MAX_MARKS
from lidarcodec.settings import is_name
from lidarcodec.transport import Transport
from lidarcodec.transport.keys import StreamKeys
from lidarcodec.untrusted.json import JsonRefusedError, read_object
from lidarcodec_server.fleet.fleet import Fleet
from lidarcodec_server.limits import SparseLog
from lidarcodec_server.past.fetches import OF_MARK, Fetches

logger = logging.getLogger(__name__)

LOOK_S: Final = 5.0
MAX_ANSWER: Final = 2**19
"""Largest answer about what a vehicle keeps: its marks take half of that."""
CLOSE_S: Final = 6.0
MOST_LEFT_OUT: Final = 64
"""Most looks in a row at which a stream that does not answer is not asked: first one, then twice as many each time. To
wait for its answer keeps those behind it waiting, and it may be one of many."""


class _SilentError(LidarCodecError):
    """A vehicle does not answer, or what it answers cannot be read."""


class Marked:
    """Looks at the status of all vehicles, and asks those whose marks have changed.

    A clip that was fetched, or could not be, is not fetched again.
    """

    def __init__(self, fleet: Fleet, fetches: Fetches, transport: Callable[[], Transport], answer_s: float) -> None:
        self._fleet, self._fetches, self._transport, self._answer_s = fleet, fetches, transport, answer_s
        self._told: dict[StreamKeys, tuple[int, int]] = {}
        self._silent: dict[StreamKeys, tuple[int, int]] = {}
        """Of streams that did not answer: how many looks were left out last, and how many of them are to come."""
        self._warnings = SparseLog(logger)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="lidarcodec server marks", daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def close(self) -> None:
        """End. A second call does nothing."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(CLOSE_S)

    def _run(self) -> None:
        while not self._stop.wait(LOOK_S):
            streams = self._fleet.streams()
            self._told = {one.keys: self._told[one.keys] for one in streams if one.keys in self._told}
            self._silent = {one.keys: self._silent[one.keys] for one in streams if one.keys in self._silent}
            for stream in streams:
                marks = _marks_in(stream.status) if stream.alive else None
                if marks is not None and marks != self._told.get(stream.keys, (0, 0)) and self._asks(stream.keys):
                    try:
                        self._fetch(stream.keys)
                        self._told[stream.keys] = marks
                        self._silent.pop(stream.keys, None)
                    except LidarCodecError as error:
                        self._leave_out(stream.keys, isinstance(error, _SilentError))
                        self._warnings.warning(
                            "%s: its marked clips cannot be fetched yet: %s", stream.keys.prefix, error
                        )
                    except Exception:
                        logger.exception("%s: its marked clips cannot be fetched", stream.keys.prefix)

    def _asks(self, keys: StreamKeys) -> bool:
        """Whether a stream is asked at this look."""
        last, left = self._silent.get(keys, (0, 0))
        if left:
            self._silent[keys] = last, left - 1
        return not left

    def _leave_out(self, keys: StreamKeys, silent: bool) -> None:
        """Leave out some looks at a stream that does not answer."""
        last = self._silent.pop(keys, (0, 0))[0]
        if silent:
            looks = min(max(2 * last, 1), MOST_LEFT_OUT)
            self._silent[keys] = looks, looks

    def _fetch(self, keys: StreamKeys) -> None:
        """Begin to fetch the clips of all marks that are new. Raises LidarCodecError if that must be tried again."""
        question = json.dumps({"ask": "spans"}).encode()
        data = self._transport().ask(keys.past, question, self._answer_s, beside=True)
        try:
            told: Any = {} if data is None else read_object(data, MAX_ANSWER).get("marks")
        except JsonRefusedError as error:
            raise _SilentError(f"the vehicle's answer cannot be read: {error}") from None
        if not isinstance(told, list):
            raise _SilentError("the vehicle does not answer")
        known = {record.clip for record in self._fetches.all()}
        for mark in told[:MAX_MARKS]:
            clip = _clip_of(keys, mark)
            if clip is not None and clip not in known:
                self._fetches.begin(clip, f"{OF_MARK}{mark['name']}", stays=True)
            elif clip is not None:
                self._fetches.keep(clip)


def _marks_in(status: dict[str, Any] | None) -> tuple[int, int] | None:
    """Number of marks by a vehicle's status, and when the newest was made; None if it keeps nothing."""
    past = None if status is None else status.get("past")
    if not isinstance(past, dict) or not isinstance(past.get("marks"), int):
        return None
    return past["marks"], past.get("marked_ns") or 0


def _clip_of(keys: StreamKeys, mark: Any) -> Clip | None:
    """The clip of a mark; None if a vehicle tells something else."""
    if not isinstance(mark, dict) or not is_name(str(mark.get("name"))):
        return None
    from_ns, to_ns = mark.get("from_ns"), mark.get("to_ns")
    if not isinstance(from_ns, int) or not isinstance(to_ns, int) or to_ns - from_ns > MAX_MARK_NS:
        return None
    try:
        return Clip(keys, from_ns, to_ns)
    except LidarCodecError:
        return None
