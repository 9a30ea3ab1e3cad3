"""Refining: sends refinements of the last frame while the link has room (`base_error_m`).

A sector is sent when no message is under way, and the sector before has arrived; on a path with a long round trip,
a few may be under way. What is left when the next frame comes is given up, so that a message waits for one sector at
most. Before the next message is due, the link rests for as long as it needs for a message: many links let that much
pass at once after a rest. Where a sector takes too long for that, one is tried now and then. Sectors are coded when
they are sent: those that are given up cost no time.

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
from lidarcodec.apps.reports import read_refined
from lidarcodec.errors import TransportError
from lidarcodec.layers import SECTORS, RefinableFrame
from lidarcodec.settings import is_name
from lidarcodec.transport import Transport
from lidarcodec.transport.base import Closeable, Priority, Sender
from lidarcodec.transport.keys import StreamKeys
from lidarcodec.wire import checksum_of

TICK_S = 0.01
"""Interval at which the thread looks whether a message is under way."""
MOST_UNDER_WAY = 6
_JOIN_S = 5.0
_SMOOTH, _SLOWER = 0.25, 0.75
_RISE = 1.01
MARGIN = 1.25
"""Times are taken to be so much longer than measured."""
TRIED_AGAIN, SELDOM = 8, 256
"""Frames without a sector, after which one is tried; twice as many each time that it was no use, up to the second."""


class _Put(NamedTuple):
    """A sector under way. alone: whether it was the only one"""

    checksum: int
    at_s: float
    size: int
    alone: bool


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
        self._took_s: float | None = None  # from put to report, of a sector alone on its way
        self._s_per_byte: float | None = None  # of the same sectors, without the round trip
        self._rtt_s: float | None = None  # the shortest one: those beside messages are longer
        self._base_bytes = 0
        self._patience, self._without = TRIED_AGAIN, 0
        self._trial = self._tried = False  # whether a sector goes that may take too long, and whether it went
        self._followed: str | None = None  # the last followed receiver that reported a refinement
        self._last_put_s: float | None = None
        self._interval_s: float | None = None
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
            now_s = time.monotonic()
            if self._last_put_s is not None:
                self._interval_s = mean_of(self._interval_s, now_s - self._last_put_s)
            self._last_put_s, self._base_bytes = now_s, size
            self._frame = frame
            self._condition.notify_all()
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="lidarcodec refinements", daemon=True)
            self._thread.start()

    def finish(self, limit_s: float) -> None:
        """No message follows. Wait until the last frame is refined and all sectors have arrived, at most `limit_s`."""
        with self._condition:
            self._finishing = True
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
            self._count("no_receiver")
            return
        left = frame.sectors
        self._tried = False
        self._count("frames")
        with self._condition:
            self._wait_no_longer()
        while left and self._has_room(turn):
            try:
                data = frame.code(left[0])
            except Exception as error:  # after any error the next frame is refined
                self._once.add("refinement errors", error)
                break
            try:
                if not self._put(senders[left[0]], (frame.frame.index, left[0]), data, turn):
                    break
            except TransportError as error:  # as with messages: the next frame tries again
                self._once.add("refinement errors", error)
                break
            left = left[1:]
        self._count("given_up", len(left))
        self._count("whole", not left)
        with self._condition:
            self._tries(sent=len(left) < len(frame.sectors))

    def _wait_no_longer(self) -> None:
        """Do not wait for reports that did not come with the last frame; those sectors took at least until now."""
        now_s = time.monotonic()
        for one in self._under_way.values():
            if one.alone and now_s - one.at_s > (self._took_s or 0.0):
                self._learn(one, now_s - one.at_s)
        self._late = self._under_way
        self._under_way = {}

    def _learn(self, one: _Put, took_s: float) -> None:
        rtt_s = self._flight.rtt_s or 0.0
        self._rtt_s = rtt_s if self._rtt_s is None else min(rtt_s, _RISE * self._rtt_s)
        self._took_s = smoothed(self._took_s, took_s)
        self._s_per_byte = smoothed(self._s_per_byte, max(0.0, took_s - self._rtt_s) / one.size)

    def _tries(self, *, sent: bool) -> None:
        """After a frame: perhaps try a sector with the next one, although the last ones took too long."""
        if sent:
            self._patience = self._patience if self._trial else TRIED_AGAIN
            self._without = 0
            self._trial = False
            return
        self._without += 1
        if self._without >= self._patience:
            self._trial = True
            self._without, self._patience = 0, min(2 * self._patience, SELDOM)

    def _put(self, sender: Sender, name: tuple[int, int], data: bytes, turn: int) -> bool:
        with self._condition:
            if turn != self._turn:
                return False
            self._under_way[name] = _Put(checksum_of(data), time.monotonic(), len(data), not self._under_way)
            self._counts["sent"] += 1
            self._counts["bytes"] += len(data)
        try:
            sender.put(data)
        except TransportError:
            with self._condition:
                self._under_way.pop(name, None)
            raise
        return True

    def _has_room(self, turn: int) -> bool:
        """Wait until a sector may be sent. False: the next frame has come."""
        with self._condition:
            while turn == self._turn:
                if len(self._under_way) < self._window() and not self._flight.busy and self._arrives_in_time():
                    return True
                self._condition.wait(TICK_S)
            return False

    def _arrives_in_time(self) -> bool:
        if self._interval_s is None or self._took_s is None or self._last_put_s is None or self._finishing:
            return True
        if self._trial and not self._tried:
            self._tried = True
            return True
        rest_s = min(MARGIN * self._base_bytes * (self._s_per_byte or 0.0), self._interval_s / 2)
        return time.monotonic() + MARGIN * self._took_s + rest_s < self._last_put_s + self._interval_s

    def _window(self) -> int:
        """How many sectors may be under way: 1 + round trip / time to send one."""
        took_s, rtt_s = self._took_s, self._flight.rtt_s
        if took_s is None or rtt_s is None or rtt_s <= 0.0:
            return 1
        return 1 + min(MOST_UNDER_WAY, round(rtt_s / max(took_s - rtt_s, 1e-3)))

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
            if found.alone:
                self._learn(found, time.monotonic() - found.at_s)
            self._condition.notify_all()


def smoothed(before: float | None, value: float) -> float:
    """A running mean, of the mean before and a new value; it follows larger values quickly."""
    return value if before is None else before + (_SLOWER if value > before else _SMOOTH) * (value - before)


def mean_of(before: float | None, value: float) -> float:
    """A running mean, of the mean before and a new value."""
    return value if before is None else before + _SMOOTH * (value - before)
