"""Copies: segments of an archive as files here, each checked by its SHA-256, in a folder of bounded size.

A copy stays until the room is needed, so a download that was cut goes on without another copy. The folder is gone when
the server ends. Methods are for threads; they are thread-safe.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
import threading
from collections import Counter, OrderedDict
from collections.abc import Callable
from pathlib import Path
from typing import Final

from lidarcodec.archive.archive import Archive
from lidarcodec.errors import SourceError
from lidarcodec_server.archived.errors import FullError
from lidarcodec_server.archived.finding import segment_of

MAX_BYTES: Final = 4 << 30
"""Most bytes of all copies."""
MIN_FREE_BYTES: Final = 256 << 20
"""So much of the disk stays free."""


class Copies:
    """Copies of segments. `close` removes them."""

    def __init__(self, archive: Archive, *, max_bytes: int = MAX_BYTES, min_free_bytes: int = MIN_FREE_BYTES) -> None:
        self._archive, self._max_bytes, self._min_free_bytes = archive, max_bytes, min_free_bytes
        self._folder = Path(tempfile.mkdtemp(prefix="lidarcodec-archive-"))
        self._lock = threading.Lock()
        self._sizes: OrderedDict[str, int] = OrderedDict()
        self._used: Counter[str] = Counter()
        self._ended = threading.Event()

    def path(self, segment: str) -> Path:
        """Where the copy of a segment lies. segment: an id"""
        return self._folder / f"{segment}.mcap"

    def borrow(self, segment: str) -> Callable[[], None] | None:
        """Keep a copy that is here until the function that is returned is called; None if there is none."""
        with self._lock:
            if segment not in self._sizes:
                return None
            self._sizes.move_to_end(segment)
            self._used[segment] += 1

        def give_back() -> None:
            with self._lock:
                self._used -= Counter([segment])

        return give_back

    def make(self, segment: str, stop: threading.Event) -> None:
        """Copy a segment. One call at a time for each segment. stop: set to give up

        Raises NoSegmentError, FullError, SourceError if it is damaged, OSError, of these TimeoutError after `stop`.
        """
        commit, value = segment_of(self._archive, segment)
        name, size = value["object"], value["bytes"]
        self._make_room(segment, size)
        path = self.path(segment)
        done = False
        try:
            digest, count = hashlib.sha256(), 0
            with path.with_suffix(".part").open("wb") as file:
                for chunk in self._archive.store.chunks(name):
                    if stop.is_set() or self._ended.is_set():
                        raise TimeoutError("the copy took too long")
                    count += len(chunk)
                    if count > size:
                        break
                    digest.update(chunk)
                    file.write(chunk)
            if count != size or digest.hexdigest() != value["sha256"]:
                raise SourceError(f"{name} is damaged: it is not what its commit says")
            # equal times for equal copies, so that a download goes on after the copy was made again
            os.utime(path.with_suffix(".part"), ns=(commit.last_ns, commit.last_ns))
            path.with_suffix(".part").replace(path)
            done = True
        finally:
            path.with_suffix(".part").unlink(missing_ok=True)
            with self._lock:
                if not done:
                    self._sizes.pop(segment, None)
                self._used -= Counter([segment])

    def close(self) -> None:
        """Remove all copies. Those under way end soon."""
        self._ended.set()
        shutil.rmtree(self._folder, ignore_errors=True)

    def _make_room(self, segment: str, size: int) -> None:
        """Reserve room for a copy, which is in use then. Copies that nobody uses go, the oldest use first."""
        if size > self._max_bytes:
            raise FullError("the segment is larger than all copies at the server may be: use `archive get` instead")
        with self._lock:
            for other in [one for one in self._sizes if not self._used[one]]:
                if self._fits(size):
                    break
                self.path(other).unlink(missing_ok=True)
                del self._sizes[other]
            if not self._fits(size):
                raise FullError("there is no room for a copy of the segment at the server: try again later")
            self._sizes[segment] = size
            self._used[segment] += 1

    def _fits(self, size: int) -> bool:
        free = shutil.disk_usage(self._folder).free
        return sum(self._sizes.values()) + size <= self._max_bytes and free - size >= self._min_free_bytes
