"""Turns: changes of one stream come one after another; those of different streams do not wait for each other."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from lidarcodec.errors import LidarCodecError
from lidarcodec.transport.keys import StreamKeys

TURN_S = 10.0
"""Longest wait of a change for earlier ones."""


class BusyError(LidarCodecError):
    """Other changes of the stream take too long."""


class Turns:
    """A lock for each stream that is changed now. Thread-safe."""

    def __init__(self) -> None:
        self._held: dict[StreamKeys, tuple[threading.Lock, int]] = {}
        self._lock = threading.Lock()

    @contextmanager
    def hold(self, keys: StreamKeys) -> Iterator[None]:
        """Hold the lock of a stream.

        Raises BusyError if it is not free in time.
        """
        with self._lock:
            lock, users = self._held.get(keys, (threading.Lock(), 0))
            self._held[keys] = lock, users + 1
        try:
            if not lock.acquire(timeout=TURN_S):
                raise BusyError(
                    f"other changes of the settings of {keys.vehicle}/{keys.sensor} are still running: try again later"
                )
            try:
                yield
            finally:
                lock.release()
        finally:
            with self._lock:
                lock, users = self._held[keys]
                if users == 1:
                    del self._held[keys]
                else:
                    self._held[keys] = lock, users - 1
