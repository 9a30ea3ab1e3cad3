"""SpareLearning: a thread in which a stream's encoder learns from what it has sent, as much as its settings allow.

Each frame that was encoded allows so many milliseconds (`learn_ms`); what is not used within a second of frames is
forgotten, so that nothing is caught up with. It counts the processor time of this thread. The thread has a lower
priority than the others of its process, releases Python's lock while it computes, and does a few milliseconds at a
time, so the encoder hardly notices it where a core is free, and goes first where none is.
"""

from __future__ import annotations

import contextlib
import os
import threading
import time
from typing import Any, Final

from lidarcodec.apps.ending import ended
from lidarcodec.apps.once import Once
from lidarcodec.pipeline import StreamEncoder

SLICE_MS: Final = 5.0
"""At a time."""
SLICE_STEPS: Final = 1000
MOST_FRAMES: Final = 10
"""Frames whose time may be left over."""
NICENESS: Final = 10
IDLE_S: Final = 0.05
"""Between two looks for samples where there were too few."""


class SpareLearning:
    """Lets an encoder learn. Its thread begins with the first frame whose settings ask for it."""

    def __init__(self, encoder: StreamEncoder, once: Once) -> None:
        self._encoder, self._once = encoder, once
        self._condition = threading.Condition()
        self._credit_ms = self._seconds = 0.0
        self._closed = False
        self._thread: threading.Thread | None = None

    def encoded(self) -> None:
        """A frame was encoded. Called by the thread that encodes."""
        allowed_ms = self._encoder.learn_ms
        if allowed_ms <= 0 and self._thread is None:
            return
        with self._condition:
            self._credit_ms = min(self._credit_ms + allowed_ms, MOST_FRAMES * allowed_ms)
            if self._thread is None and not self._closed:
                self._thread = threading.Thread(target=self._run, name="lidarcodec learning", daemon=True)
                self._thread.start()
            self._condition.notify_all()

    def state(self) -> dict[str, Any] | None:
        """For the status: what was learned, and the processor time that it took; None before it began."""
        learned = self._encoder.learned
        return None if learned is None else {**learned, "seconds": round(self._seconds, 3)}

    def close(self) -> None:
        """End the thread; harmless when called twice."""
        with self._condition:
            self._closed = True
            self._condition.notify_all()
        if self._thread is not None:
            ended([self._thread])

    def _run(self) -> None:
        with contextlib.suppress(OSError):  # threads have priorities of their own on Linux
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICENESS)
        while self._allowed():
            began = time.thread_time()
            try:
                steps = self._encoder.learn(SLICE_STEPS, min(self._credit_ms, SLICE_MS))
            except Exception as error:  # whatever goes wrong here, the stream goes on
                self._once.add("learning errors", error)
                return
            took = time.thread_time() - began
            with self._condition:
                self._seconds += took
                self._credit_ms -= 1e3 * took
                if not steps:
                    self._condition.wait_for(lambda: self._closed, IDLE_S)

    def _allowed(self) -> bool:
        """Waits until time is left, or the end: False."""
        with self._condition:
            self._condition.wait_for(lambda: self._closed or self._credit_ms > 0)
            return not self._closed
