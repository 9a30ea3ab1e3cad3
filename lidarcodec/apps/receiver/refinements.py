"""Refinements: those of a live stream, put on decoded bases.

    handler         refinement -> a few that wait
    refine thread   admission -> report of the arrival -> recording -> the frame of its base

Each base is held until all of its sectors are there, or the next message comes. So frames are given up to a frame later
than without refinements.
"""

from __future__ import annotations

import logging
import threading
from collections import Counter, deque
from collections.abc import Callable
from typing import Final

from lidarcodec.apps.once import Once
from lidarcodec.apps.receiver.admission import Admission
from lidarcodec.apps.reports import Refined, pack_refined
from lidarcodec.errors import DecodeError, TransportError
from lidarcodec.frame import Frame
from lidarcodec.layers import SECTORS, OtherBaseError, RefinedFrame, Refinement, can_be_base, unpack
from lidarcodec.message import Message
from lidarcodec.recording.refinements import Refinements as Kept
from lidarcodec.transport import Transport
from lidarcodec.transport.base import Closeable, Priority, Sender
from lidarcodec.transport.keys import StreamKeys
from lidarcodec.wire import checksum_of

logger = logging.getLogger(__name__)

WAITING: Final = 16
"""Most refinements that wait for the thread; a publisher sends a few at once. Beyond that the oldest are lost."""
WAITING_BYTES: Final = 16 * 2**20
"""Most bytes of them. A sector has 10 kB."""
FAILED: Final = SECTORS
"""Most refinements of a base that may be damaged. Then no other is decoded, so that they hold up no frame."""
_JOIN_S = 5.0


class Refinements:
    """Takes the refinements of one stream.

    on_frame: called with each frame, refined as far as it is, in one of two threads, one at a time
    on_refinement: called with the bytes of each refinement, in the refine thread
    counts: sectors `taken`, and those that came too `late` for their frame or were `lost` here; those `left_out`, which
        came twice, or were too many of a sector; frames refined `whole`, in `part`, or not at all (`base`)
    """

    def __init__(
        self,
        keys: StreamKeys,
        name: str,
        on_frame: Callable[[Frame], object],
        on_refinement: Callable[[bytes], object],
        once: Once,
    ) -> None:
        self._keys, self._name, self._once = keys, name, once
        self._on_frame, self._on_refinement = on_frame, on_refinement
        self._waiting: deque[bytes] = deque()
        self._bytes = 0
        self._condition = threading.Condition()
        self._giving = threading.RLock()
        self._held: RefinedFrame | None = None
        self._newest: tuple[int, int] | None = None
        self._kept, self._admission, self._failed = Kept(), Admission(), 0
        self._closed = False
        self.counts: Counter[str] = Counter(lost=0)
        self._thread: threading.Thread | None = None

    def declare(self, transport: Transport) -> list[Closeable]:
        """Begin to take refinements."""
        reports = transport.sender(self._keys.refined(self._name), Priority.REAL_TIME)
        self._thread = threading.Thread(target=self._run, args=(reports,), name="lidarcodec refine", daemon=True)
        self._thread.start()
        return [transport.listen(self._keys.refine(), self._came), reports]

    def close(self) -> None:
        """End the thread. A second call does nothing."""
        with self._condition:
            self._closed = True
            self._condition.notify()
        thread = self._thread
        if thread is not None and thread is not threading.current_thread():
            thread.join(_JOIN_S)

    def flush(self) -> None:
        """Give the held frame, if there is one."""
        with self._giving:
            held, self._held = self._held, None
            if held is not None:
                self.counts["whole" if held.whole else "part" if held.taken else "base"] += 1
                self._on_frame(held.frame())

    def message(self, message: Message) -> None:
        """A message came, and was recorded: from now on its refinements are taken."""
        with self._condition:
            for data in self._admission.message(message):
                self._wait(data)

    def base(self, frame: Frame, message: Message) -> None:
        """A frame was decoded. It is given now, if nothing can refine it."""
        if not can_be_base(message):
            self._on_frame(frame)
            return
        with self._giving:
            self._held, self._failed = RefinedFrame(frame, message), 0
            self._newest = (message.stream_id, message.frame_index)
            for data in self._kept.take(message):
                self._add(data)

    def _came(self, key: str, data: bytes) -> None:
        with self._condition:
            self._wait(data)

    def _wait(self, data: bytes) -> None:
        self._waiting.append(data)
        self._bytes += len(data)
        while len(self._waiting) > WAITING or self._bytes > WAITING_BYTES:
            self._bytes -= len(self._waiting.popleft())
            self.counts["lost"] += 1
        self._condition.notify()

    def _run(self, reports: Sender) -> None:
        undecoded: deque[tuple[tuple[int, int], bytes]] = deque()
        while True:
            with self._condition:
                self._condition.wait_for(lambda: bool(self._waiting or undecoded) or self._closed)
                if self._closed:
                    return
                waiting = list(self._waiting)
                self._waiting.clear()
                self._bytes = 0
            for data in waiting:  # all are reported before one is decoded: the publisher waits for the reports
                try:
                    one = unpack(data)  # checks the checksum before anything is counted
                except DecodeError as error:
                    self._once.add("refinement_errors", error)
                    continue
                if not self._admits(one, data):
                    continue
                try:
                    reports.put(pack_refined(Refined(one.frame_index, checksum_of(data), one.sector)))
                except TransportError as error:
                    self._once.add("arrival_errors", error)
                self._keep(data)
                undecoded.append(((one.stream_id, one.frame_index), data))
            while len(undecoded) > WAITING or sum(len(data) for _, data in undecoded) > WAITING_BYTES:
                undecoded.popleft()
                self.counts["lost"] += 1
            if undecoded:
                self._take(*undecoded.popleft())

    def _admits(self, one: Refinement, data: bytes) -> bool:
        with self._condition:
            admitted = self._admission.admits(one, data)
        if admitted is False:
            self.counts["left_out"] += 1
        return admitted is True

    def _keep(self, data: bytes) -> None:
        try:
            self._on_refinement(data)
        except Exception as error:  # of the caller's function: refining goes on
            logger.exception("a refinement could not be kept")
            self._once.add("refinement_errors", error)

    def _take(self, of: tuple[int, int], data: bytes) -> None:
        """of: stream and index of its frame"""
        with self._giving:
            if self._held is not None and of == self._newest:
                self._add(data)
            elif self._newest is not None and of[0] == self._newest[0] and of[1] <= self._newest[1]:
                self.counts["late"] += 1
            else:  # its base is being decoded
                self._kept.put(data)

    def _add(self, data: bytes) -> None:
        held = self._held
        if held is None:
            self.counts["late"] += 1
            return
        if self._failed >= FAILED:
            self.counts["lost"] += 1
            return
        try:
            self.counts["taken"] += held.add(unpack(data))
        except DecodeError as error:
            self._failed += not isinstance(error, OtherBaseError)  # that costs nothing
            self._once.add("refinement_errors", error)
        except Exception as error:  # an error in the decoder: only this refinement is lost
            self._failed += 1
            logger.exception("frame %d could not be refined", held.base.index)
            self._once.add("refinement_errors", error)
        if held.whole:
            self.flush()
