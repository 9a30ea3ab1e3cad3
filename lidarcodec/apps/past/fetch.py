"""Fetch: gets a clip of what a vehicle kept, over a network that may be slow and may fail at any time.

First it asks which pieces the clip has, then it asks for one part of a piece after the other. The vehicle sends each
between two live messages, as large as there is room. Where the vehicle does not know the room, parts become larger as
long as they take less than PART_S beyond the shortest round trip, so they never hold a live message up for long. Every
piece is checked by its SHA-256.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from lidarcodec.apps.past.answers import HEAD, PART
from lidarcodec.apps.past.plan import Clip, Plan
from lidarcodec.apps.past.times import MAX_AHEAD_NS
from lidarcodec.errors import LidarCodecError, SourceError
from lidarcodec.files.piece_store import PieceStore
from lidarcodec.recording.pieces import Piece
from lidarcodec.transport import Transport
from lidarcodec.transport.asking import reason_of, retry_of, until_answered
from lidarcodec.transport.part_size import MAX_PART, PartSize
from lidarcodec.untrusted.json import JsonRefusedError, read_object
from lidarcodec.untrusted.times import rfc_3339

logger = logging.getLogger(__name__)

FRESH_S: Final = 5.0
"""How long the newest pieces are waited for, after the vehicle has told of no new ones."""
RECORDING: Final = "for the vehicle to record the rest"
"""What a fetch waits for while the vehicle answers, and its newest pieces end before the clip."""
GROWN_NS: Final = 10**9
"""The vehicle has recorded more when the end of its newest piece is so much later."""
FAR_NS: Final = MAX_AHEAD_NS + 60 * 10**9
"""Nobody may ask for a clip that ends so far ahead. The clock of a vehicle that has so much to record yet is behind."""
STUCK_S: Final = 60.0
"""Longest time in which a vehicle may answer without bringing the fetch on."""
LEAST_PART: Final = 1024
"""A shorter part of a piece does not bring the fetch on, unless less was asked for."""
MAX_LIST_BYTES: Final = 1 << 20
MAX_WRONG: Final = 3
"""Most times that a piece may come with the wrong bytes."""


class CancelledError(LidarCodecError):
    """The fetch was cancelled; what was fetched is still there."""


class TurnOverError(LidarCodecError):
    """Others have their turn. What was fetched is still there, and `run` goes on from it."""


class SilentError(SourceError):
    """The vehicle did not answer for too long; what was fetched is still there."""


class Fetch:
    """Fetches one clip into a store. `run` blocks; call it from a thread. Its state can be read from others.

    plan_file:  where the plan is stored, to go on after a restart
    transport:  gives the network session, or raises TransportError while there is none
    patience_s: longest time without any progress
    turn_over:  asked all the time, also while it waits: whether others have their turn now
    """

    def __init__(
        self,
        clip: Clip,
        store: PieceStore,
        plan_file: Path,
        transport: Callable[[], Transport],
        patience_s: float,
        turn_over: Callable[[], bool] = lambda: False,
    ) -> None:
        self.clip, self._store, self._plan_file = clip, store, plan_file
        self._transport, self._patience_s, self._turn_over = transport, patience_s, turn_over
        self.plan = Plan.read(plan_file, clip)
        self._stop = threading.Event()
        self._moved_s = self._gained_s = time.monotonic()
        self._parts = PartSize()
        self.received = 0
        self.waiting: str | None = None
        self._now: tuple[str, int] | None = None

    def cancel(self) -> None:
        """Make `run` end soon."""
        self._stop.set()

    def state(self) -> dict[str, Any]:
        """Progress: pieces and bytes, what was received over the network, and what it waits for."""
        there = self.plan.there
        done = [piece for piece in there if self._store.has(piece.name, piece.size)]
        begun = self._now
        return {
            "listed": self.plan.listed,
            "pieces": len(there),
            "pieces_done": len(done),
            "bytes": sum(piece.size for piece in there),
            "bytes_done": sum(piece.size for piece in done) + (0 if begun is None else begun[1]),
            "bytes_received": self.received,
            "frames": sum(piece.frames for piece in there),
            "gaps": [list(gap) for gap in self.plan.gaps()] if self.plan.listed else [],
            "waiting": self.waiting,
        }

    def run(self, listed: Callable[[Plan], None] = lambda plan: None) -> Plan:
        """Fetch everything. Returns the plan; all of its pieces that are not gone are in the store.

        listed: called when all pieces are known
        Raises SourceError if the vehicle kept nothing of the clip, SilentError if it does not answer for `patience_s`,
        CancelledError, TurnOverError, and what `listed` raises.
        """
        self._moved_s = self._gained_s = time.monotonic()
        while not self.plan.listed:
            self._list()
        listed(self.plan)
        for piece in self.plan.there:
            self._piece(piece)
        if not self.plan.there:
            raise SourceError("the vehicle has overwritten this clip: nothing of it is left")
        return self.plan

    # --- the list ---------------------------------------------------------------------------------------------------

    def _list(self) -> None:
        """Ask for all pieces, and wait for those that are being recorded."""
        clip, at_ns, fresh_s = self.clip, self.clip.from_ns, time.monotonic()
        until_before, idle = -1, 0
        while True:
            told = self._ask_object({"ask": "pieces", "from": at_ns, "to": clip.to_ns})
            pieces, until_ns = told.get("pieces"), told.get("until_ns")
            if not isinstance(pieces, list):
                raise SourceError("the vehicle's list of pieces cannot be understood")
            if self.plan.add(pieces):
                self.plan.store(self._plan_file)
                self._gained_s, idle = time.monotonic(), 0
            else:
                idle += 1
            if told.get("more") is True and pieces:
                if idle > 1:  # the first one may be known from before
                    raise SourceError("the vehicle's list of pieces has no end")
                last = self.plan.pieces[-1] if self.plan.pieces else None
                at_ns = max(at_ns + 1, last.begin_ns + 1 if last is not None else 0)
                self._check_going()
                continue
            until = until_ns if isinstance(until_ns, int) and not isinstance(until_ns, bool) else -1
            if until >= until_before + GROWN_NS:
                if until_before >= 0 and clip.to_ns - until > FAR_NS:
                    break
                until_before, fresh_s = until, time.monotonic()
                self._gained_s = fresh_s
            if until >= clip.to_ns or time.monotonic() - fresh_s > FRESH_S:
                break
            self.waiting = RECORDING
            self._pause(1.0)
        self.waiting = None
        if not self.plan.pieces:
            raise SourceError(f"the vehicle has nothing from this time: {self._kept()}")
        self.plan.listed = True
        self.plan.store(self._plan_file)

    def _kept(self) -> str:
        """What the vehicle keeps, in words."""
        try:
            spans = self._ask_object({"ask": "spans"}).get("spans")
        except SourceError:
            return "ask for another"
        times = [at for span in spans if isinstance(span, list) for at in span] if isinstance(spans, list) else []
        if any(not isinstance(at, int) or isinstance(at, bool) or not 0 <= at < 2**63 for at in times):
            return "ask for another"
        if not times:
            return "it has kept nothing yet"
        gaps = ", with gaps" * (len(times) > 2)
        return f"ask for one from {rfc_3339(min(times))} to {rfc_3339(max(times))}{gaps}"

    # --- pieces -----------------------------------------------------------------------------------------------------

    def _piece(self, piece: Piece) -> None:
        for _ in range(MAX_WRONG):
            if self._store.has(piece.name, piece.size):
                self._now = None
                return
            offset = min(self._store.got(piece.name), piece.size)
            while offset < piece.size:
                self._now = piece.name, offset
                data = self._part(piece, offset)
                if data is None:
                    self.plan.gone.add(piece.name)
                    self.plan.store(self._plan_file)
                    self._now = None
                    return
                self._store.add(piece.name, offset, data)
                offset += len(data)
            self._now = None
            if self._store.finish(piece.name):
                return
            logger.warning("a part of the clip arrived damaged, and is fetched again")
        raise SourceError(f"a part of the clip arrived damaged {MAX_WRONG} times: try again")

    def _part(self, piece: Piece, offset: int) -> bytes | None:
        """The next bytes of a piece; None if the vehicle does not keep it any more."""
        most = min(MAX_PART, piece.size - offset)
        size = min(self._parts.bytes, most)
        where = {"piece": piece.name, "at_ns": piece.begin_ns, "offset": offset}
        question = {"ask": "part", **where, "bytes": size, "most": most}
        while True:
            answer, took_s = self._ask(question)
            if answer and answer[0] == PART:
                break
            told = _object(answer)
            if told.get("field") == "piece":
                return None
            self._wait_or_raise(told)
        if not HEAD.size < len(answer) <= HEAD.size + most:
            raise SourceError("the vehicle's answer cannot be understood")
        if len(answer) == HEAD.size + size:  # else the vehicle measured the room
            waited_s = HEAD.unpack_from(answer)[1] / 1e6
            self._parts.took(size, max(0.0, took_s - waited_s))
        self.received += len(answer)
        if len(answer) >= HEAD.size + min(LEAST_PART, size):
            self._gained_s = time.monotonic()
        return answer[HEAD.size :]

    # --- questions --------------------------------------------------------------------------------------------------

    def _ask_object(self, question: dict[str, Any]) -> dict[str, Any]:
        """Raises SourceError for a refusal."""
        while True:
            told = _object(self._ask(question)[0])
            if "error" not in told:
                return told
            self._wait_or_raise(told)

    def _wait_or_raise(self, told: dict[str, Any]) -> None:
        """Wait until a refused question may be asked again. Raises SourceError for a refusal for good."""
        retry_s = retry_of(told)
        if retry_s is None:
            raise SourceError(f"the vehicle refuses: {reason_of(told)}")
        self._pause(retry_s)

    def _ask(self, question: dict[str, Any]) -> tuple[bytes, float]:
        """The answer, and how long it took in s. Waits until there is one."""
        key = self.clip.keys.past
        found = until_answered(self._transport, key, question, self._check_going, self._silent, self._pause)
        self._moved_s, self.waiting = time.monotonic(), None
        return found

    def _silent(self) -> None:
        self.waiting = "for the vehicle to answer"
        self._parts.lost()

    def _pause(self, seconds: float) -> None:
        self._stop.wait(seconds)
        self._check_going()

    def _check_going(self) -> None:
        """Raises CancelledError, TurnOverError, and SourceError if nothing, or nothing new, came for too long."""
        if self._stop.is_set():
            raise CancelledError("the fetch was cancelled")
        if time.monotonic() - self._moved_s > self._patience_s:
            raise SilentError(
                f"{self.clip.keys.vehicle}/{self.clip.keys.sensor} did not answer for {self._patience_s:g} s: "
                "is it connected, and does it publish with --keep?"
            )
        if time.monotonic() - self._gained_s > max(STUCK_S, self._patience_s):
            raise SourceError("the vehicle answers, but has sent nothing new for too long")
        if self._turn_over():
            raise TurnOverError("others have their turn")


def _object(answer: bytes) -> dict[str, Any]:
    try:
        return read_object(answer, MAX_LIST_BYTES)
    except JsonRefusedError as error:
        raise SourceError(f"the vehicle's answer cannot be read: {error}") from None
