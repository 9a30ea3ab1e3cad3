"""Refining: sends refinements of the last frame while the link has room (`base_error_m`).

A sector is sent when no message is under way, and the sector before has arrived. On a path with a long round trip it
does not wait for reports, but until the link is free by its measured rate; a report that is late stops it. `Pacing`
says whether a sector arrives long enough before the next message is due. What is left when the next frame comes is
given up. A sector is coded shortly before it is sent: most of those that are given up cost no time.

Reports of the receiver that the stream follows count, if it takes refinements, else those of all receivers.
"""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable
from typing import Any, NamedTuple

from lidarcodec.apps.once import Once
from lidarcodec.apps.publisher.flight import Flight
from lidarcodec.apps.publisher.pacing import Pacing
from lidarcodec.apps.publisher.path_times import SHORT_PATH_S
from lidarcodec.apps.reports import read_refined
from lidarcodec.errors import TransportError
from lidarcodec.layers import SECTORS, RefinableFrame
from lidarcodec.settings import is_name
from lidarcodec.transport import Transport
from lidarcodec.transport.base import Closeable, Priority, Sender
from lidarcodec.transport.keys import StreamKeys
from lidarcodec.wire import checksum_of

TICK_S = 0.01
"""Longest interval at which the thread looks whether a message is under way."""
MOST_UNDER_WAY = 6
LATE_S = 0.02
"""A report is late when it comes so long after its predicted time."""
_JOIN_S, _LOOK_S = 5.0, 1.0
_USUAL_BYTES = 6_000
"""Taken for the size of a sector before there is one."""


class _Put(NamedTuple):
    """A sector under way. begin_s: when the link begins to carry it, and free_s: when that ends, as predicted"""

    checksum: int
    begin_s: float
    free_s: float
    size: int


class Refining:
    """Sends refinements in a thread of its own, which begins with the first frame.

    transport: gives the open transport; flight: tells whether a message is under way; once: counts and logs errors
    """

    def __init__(self, keys: StreamKeys, transport: Callable[[], Transport | None], flight: Flight, once: Once) -> None:
        self._keys, self._transport, self._flight, self._once = keys, transport, flight, once
        self._condition = threading.Condition()
        self._frame: RefinableFrame | None = None
        self._turn = 0  # counts frames: what was begun for an earlier one is given up
        self._under_way: dict[tuple[int, int], _Put] = {}
        self._late: dict[tuple[int, int], _Put] = {}  # of the frame before, not reported in time
        self._pacing = Pacing()
        self._usual_bytes = _USUAL_BYTES
        self._beside: dict[int, bool] = {}  # messages under way: whether sectors were sent before them
        self._sent_beside = False
        self._path_to: str | None = None  # the receiver whose path the pacing knows
        self._followed: str | None = None  # the last followed receiver that reported a refinement
        self._counts: Counter[str] = Counter()
        self._closed = self._busy = self._finishing = False
        self._thread: threading.Thread | None = None
        self._declared: list[Closeable] = []

    def next_frame(self) -> None:
        """A frame is about to be encoded: give up what is left of the last one."""
        with self._condition:
            self._frame = None
            self._turn += 1
            self._condition.notify_all()

    def offer(self, frame: RefinableFrame | None, size: int) -> None:
        """Refine this frame, whose message of `size` bytes was just sent; None: there is nothing to refine."""
        if frame is None:
            return
        with self._condition:
            if self._closed:
                return
            self._messages(frame.frame.index, size)
            self._frame = frame
            self._condition.notify_all()
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="lidarcodec refinements", daemon=True)
            self._thread.start()

    def finish(self, limit_s: float) -> None:
        """No message follows. Wait until the last frame is refined and all sectors have arrived, at most `limit_s`."""
        with self._condition:
            self._finishing = True
            self._condition.notify_all()
            self._condition.wait_for(
                lambda: self._closed or not (self._frame or self._busy or self._under_way), limit_s
            )

    def close(self) -> None:
        """End the thread. A second call does nothing."""
        with self._condition:
            self._closed = True
            self._turn += 1
            self._condition.notify_all()
        thread = self._thread
        if thread is not None and thread is not threading.current_thread():
            thread.join(_JOIN_S)
        for one in self._declared:
            one.close()

    def state(self) -> dict[str, Any] | None:
        """For the status: numbers of `frames` that were refined or given up, of sectors `sent`, `arrived` and
        `given_up`, `bytes` sent, `whole` frames (all sectors were sent), `no_receiver` (frames that nobody took
        refinements of); None before the first frame."""
        if self._thread is None:
            return None
        with self._condition:
            names = ("frames", "whole", "sent", "arrived", "given_up", "bytes", "no_receiver")
            return {name: self._counts[name] for name in names} | {"under_way": len(self._under_way)}

    # --- the thread -------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        try:
            transport = self._transport()
            if transport is None:
                return
            self._declared.append(transport.listen(self._keys.refined(), self._reported))
            senders = [transport.sender(self._keys.refine(sector), Priority.BESIDE) for sector in range(SECTORS)]
            self._declared += senders
            while (given := self._next()) is not None:
                self._send(senders, *given)
                with self._condition:
                    self._busy = False
                    self._condition.notify_all()
        except TransportError as error:
            if not self._closed:
                self._once.add("refinement errors", error)

    def _next(self) -> tuple[RefinableFrame, int] | None:
        with self._condition:
            self._condition.wait_for(lambda: self._frame is not None or self._closed)
            frame, self._frame = self._frame, None
            self._busy = True
            return None if self._closed or frame is None else (frame, self._turn)

    def _send(self, senders: list[Sender], frame: RefinableFrame, turn: int) -> None:
        if not any(sender.matching for sender in senders):
            with self._condition:
                self._forget_under_way()
            self._count("no_receiver")
            return
        left, alone = frame.sectors, self._alone()
        held = alone
        self._count("frames")
        while left:
            if (held or not self._fits(turn, self._usual_bytes)) and not self._is_last(turn):
                break
            held = False
            try:
                data = frame.code(left[0])
            except Exception as error:  # after any error the next frame is refined
                self._once.add("refinement errors", error)
                break
            if not self._has_room(turn, len(data)):
                if self._is_last(turn):
                    continue
                break
            try:
                if not self._put(senders[left[0]], (frame.frame.index, left[0]), data, turn):
                    break
            except TransportError as error:  # as with messages: the next frame tries again
                self._once.add("refinement errors", error)
                break
            left = left[1:]
        if not alone and len(left) == len(frame.sectors):
            with self._condition:
                self._pacing.nothing_fitted()
        self._count("given_up", len(left))
        self._count("whole", not left)

    def _is_last(self, turn: int) -> bool:
        """Nothing fits before the next message. Wait until it comes, or until it is known that none does."""
        with self._condition:
            while turn == self._turn and not self._finishing:
                self._condition.wait(_LOOK_S)
            return turn == self._turn

    def _alone(self) -> bool:
        """Begin a frame: forget what is under way, and say whether nothing is to be sent beside its message."""
        now_s, rtt_s = time.monotonic(), self._flight.rtt_s or 0.0
        with self._condition:
            lost = [one for one in self._under_way.values() if now_s - rtt_s > one.free_s]  # not reported until now
            if lost:
                first = min(lost, key=lambda one: one.begin_s)
                self._pacing.sectors_lost(now_s - rtt_s, first.begin_s, first.size)
            self._forget_under_way()
            return self._pacing.alone and not self._finishing

    def _forget_under_way(self) -> None:
        self._late, self._under_way = self._under_way, {}

    def _messages(self, index: int, size: int) -> None:
        """A message was put. Learn from those that were reported."""
        following = self._flight.following
        if following not in (None, self._path_to):
            self._path_to = following
            self._pacing.new_path()
            self._beside.clear()
            self._forget_under_way()
        for one in self._flight.took():
            beside = self._beside.pop(one.frame, None)
            if beside is not None:
                self._pacing.message_took(one.seconds, one.size, self._flight.s_per_byte, beside=beside)
        while len(self._beside) >= MOST_UNDER_WAY:
            self._beside.pop(next(iter(self._beside)))
        self._beside[index], self._sent_beside = self._sent_beside, False
        self._pacing.message(time.monotonic(), size)

    def _put(self, sender: Sender, name: tuple[int, int], data: bytes, turn: int) -> bool:
        now_s = time.monotonic()
        with self._condition:
            if turn != self._turn:
                return False
            begin_s = max(now_s, self._pacing.free_s)
            self._pacing.sector(now_s, len(data))
            self._under_way[name] = _Put(checksum_of(data), begin_s, self._pacing.free_s, len(data))
            self._sent_beside, self._usual_bytes = True, len(data)
            self._counts["sent"] += 1
            self._counts["bytes"] += len(data)
        self._flight.beside(len(data))
        try:
            sender.put(data)
        except TransportError:
            with self._condition:
                self._under_way.pop(name, None)
            raise
        return True

    def _fits(self, turn: int, size: int) -> bool:
        """Whether a sector of `size` bytes arrives before the next message is due, and that frame is not here yet."""
        with self._condition:
            return turn == self._turn and (self._finishing or self._pacing.fits(time.monotonic(), size))

    def _has_room(self, turn: int, size: int) -> bool:
        """Wait until a sector may be sent. False: it does not fit any more."""
        while self._fits(turn, size):
            rtt_s, busy, taken_s = self._flight.rtt_s or 0.0, self._flight.busy, self._flight.taken_s
            with self._condition:
                now_s = time.monotonic()
                if not busy and not self._under_way:
                    self._pacing.idle(now_s)
                wait_s = min(max(self._wait_s(now_s, rtt_s, busy=busy), taken_s), TICK_S)
                if wait_s <= 0.0:
                    return True
                if self._under_way or not busy:
                    self._condition.wait(wait_s)
                    continue
            self._flight.wait_landed(wait_s)
        return False

    def _wait_s(self, now_s: float, rtt_s: float, *, busy: bool) -> float:
        """How long to wait before the next look; 0 if the link is free."""
        if not busy and not self._under_way:
            return 0.0
        if rtt_s < SHORT_PATH_S or len(self._under_way) >= MOST_UNDER_WAY or not self._pacing.s_per_byte:
            return TICK_S
        due_s = [one.free_s for one in self._under_way.values()] + [self._pacing.message_free_s] * busy
        late = now_s > min(due_s) + rtt_s + LATE_S
        return TICK_S if late else self._pacing.free_s - now_s

    def _count(self, what: str, number: int = 1) -> None:
        with self._condition:
            self._counts[what] += number

    # --- handlers, in threads of the transport ----------------------------------------------------------------------

    def _reported(self, key: str, data: bytes) -> None:
        report = read_refined(data)
        name = key.rpartition("/")[2]
        if report is None or not is_name(name):
            return
        following = self._flight.following
        with self._condition:
            name_of = (report.frame_index, report.sector)
            waited, late = self._under_way.get(name_of), self._late.get(name_of)
            found = waited or late
            if found is None or found.checksum != report.checksum:
                return
            if name == following:
                self._followed = name
            elif following is not None and following == self._followed:
                return
            self._counts["arrived"] += 1
            if waited is None:
                del self._late[name_of]
                return
            del self._under_way[name_of]
            self._pacing.sector_took(time.monotonic(), found.begin_s, found.size, self._flight.rtt_s or 0.0)
            self._condition.notify_all()
