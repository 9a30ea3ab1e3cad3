"""Refining: sends refinements of the last frame while the link has room (`base_error_m`).

A sector is sent when no message is under way, and the sector before has arrived; on a path with a long round trip,
a few may be under way. None is sent that would still be under way when the next frame is due. What is left when that
comes is given up, so that a message waits for one sector at most. Sectors are coded when they are sent: those that are
given up cost no time.
"""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

from lidarcodec.apps.once import Once
from lidarcodec.apps.publisher.flight import Flight
from lidarcodec.apps.reports import read_refined
from lidarcodec.errors import LidarCodecError, TransportError
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
_SMOOTH = 0.25
_FORGET = 0.75


class Refining:
    """Sends refinements in a thread of its own, which begins with the first frame.

    transport: gives the open transport; flight: tells whether a message is under way; once: counts and logs errors
    """

    def __init__(self, keys: StreamKeys, transport: Callable[[], Transport | None], flight: Flight, once: Once) -> None:
        self._keys, self._transport, self._flight, self._once = keys, transport, flight, once
        self._condition = threading.Condition()
        self._frame: RefinableFrame | None = None
        self._turn = 0  # counts frames: what was begun for an earlier one is given up
        self._under_way: dict[tuple[int, int], tuple[int, float, bool]] = {}
        self._took_s: float | None = None  # from put to report, of a sector alone on its way
        self._interval_s: float | None = None
        self._begun_s = time.monotonic()
        self._counts: Counter[str] = Counter()
        self._closed = self._busy = False
        self._thread: threading.Thread | None = None
        self._declared: list[Closeable] = []

    def next_frame(self) -> None:
        """A frame is about to be encoded: give up what is left of the last one."""
        with self._condition:
            now_s = time.monotonic()
            self._interval_s, self._begun_s = smoothed(self._interval_s, now_s - self._begun_s), now_s
            self._frame = None
            self._turn += 1
            self._condition.notify_all()

    def offer(self, frame: RefinableFrame | None) -> None:
        """Refine this frame, whose message was just sent; None: there is nothing to refine."""
        if frame is None:
            return
        with self._condition:
            if self._closed:
                return
            self._frame = frame
            self._condition.notify_all()
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="lidarcodec refinements", daemon=True)
            self._thread.start()

    def finish(self, limit_s: float) -> None:
        """Wait until the last frame is refined and all sectors have arrived, at most `limit_s`."""
        with self._condition:
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
        self._count("frames")
        with self._condition:
            self._under_way.clear()  # reports that did not come with the last frame are not waited for
        while left and self._has_room(turn):
            try:
                data = frame.code(left[0])
            except LidarCodecError as error:
                self._once.add("refinement errors", error)
                break
            if not self._put(senders[left[0]], (frame.frame.index, left[0]), data, turn):
                break
            left = left[1:]
        self._count("given_up", len(left))
        self._count("whole", not left)
        if len(left) == len(frame.sectors):  # perhaps because one sector took long: try again, in time
            with self._condition:
                self._took_s = None if self._took_s is None else _FORGET * self._took_s

    def _put(self, sender: Sender, name: tuple[int, int], data: bytes, turn: int) -> bool:
        with self._condition:
            if turn != self._turn:
                return False
            self._under_way[name] = (checksum_of(data), time.monotonic(), not self._under_way)
            self._counts["sent"] += 1
            self._counts["bytes"] += len(data)
        sender.put(data)
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
        if self._interval_s is None or self._took_s is None:
            return True
        return time.monotonic() + self._took_s < self._begun_s + self._interval_s

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
        if report is None or not is_name(key.rpartition("/")[2]):
            return
        with self._condition:
            found = self._under_way.get((report.frame_index, report.sector))
            if found is None or found[0] != report.checksum:
                return
            del self._under_way[report.frame_index, report.sector]
            self._counts["arrived"] += 1
            if found[2]:
                self._took_s = smoothed(self._took_s, time.monotonic() - found[1])
            self._condition.notify_all()


def smoothed(before: float | None, value: float) -> float:
    """A running mean, of the mean before and a new value."""
    return value if before is None else before + _SMOOTH * (value - before)
