"""SpareLearning: a thread that trains a stream's encoder on sent frames, within the limit of its settings.

Each encoded frame allows this thread `learn_ms` of processor time. Time that is not used within a second of frames
expires, so the thread never has to catch up. It has a lower priority than other threads, releases Python's global lock
while it computes, and works a few milliseconds at a time. With a free core it does not slow the encoder down; without
a free core, the encoder has priority.
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
"""Longest training at a time."""
SLICE_STEPS: Final = 1000
MOST_FRAMES: Final = 10
"""Most frames whose unused time is kept."""
NICENESS: Final = 10
IDLE_S: Final = 0.05
"""Wait before the next try if there were too few samples."""


class SpareLearning:
    """Trains an encoder. The thread starts with the first frame whose settings allow it."""

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
        """For the status: state of the training and its processor time; None before it began."""
        learned = self._encoder.learned
        return None if learned is None else {**learned, "seconds": round(self._seconds, 3)}

    def close(self) -> None:
        """End the thread. A second call does nothing."""
        with self._condition:
            self._closed = True
            self._condition.notify_all()
        if self._thread is not None:
            ended([self._thread])

    def _run(self) -> None:
        with contextlib.suppress(OSError):  # on Linux each thread has its own priority
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICENESS)
        while self._allowed():
            began = time.thread_time()
            try:
                steps = self._encoder.learn(SLICE_STEPS, min(self._credit_ms, SLICE_MS))
            except Exception as error:  # the stream continues after any error here
                self._once.add("learning errors", error)
                return
            took = time.thread_time() - began
            with self._condition:
                self._seconds += took
                self._credit_ms -= 1e3 * took
                if not steps:
                    self._condition.wait_for(lambda: self._closed, IDLE_S)

    def _allowed(self) -> bool:
        """Wait until there is time to use. False: the thread must end."""
        with self._condition:
            self._condition.wait_for(lambda: self._closed or self._credit_ms > 0)
            return not self._closed
