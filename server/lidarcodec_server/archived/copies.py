"""Copies: segments of an archive as files here, each checked by its SHA-256, in a folder of bounded size.

A copy stays until the room is needed, so a download that was cut goes on without another copy. The folder is gone when
the server ends. It is locked while the server runs: the next server removes folders whose servers were killed. Methods
are for threads; they are thread-safe.
"""

from __future__ import annotations

import errno
import fcntl
import hashlib
import os
import shutil
import tempfile
import threading
from collections import Counter, OrderedDict
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from io import FileIO
from pathlib import Path
from typing import Any, Final

from lidarcodec.archive.archive import Archive
from lidarcodec.errors import SourceError
from lidarcodec_server.archived.errors import FullError
from lidarcodec_server.archived.finding import Known, segment_of

MAX_BYTES: Final = 4 << 30
"""Most bytes of all copies."""
MIN_FREE_BYTES: Final = 256 << 20
"""So much of the disk stays free."""
PREFIX: Final = "lidarcodec-copies-"
"""How the folders of copies are called, in the folder for temporary files."""


class Copies:
    """Copies of segments. `close` removes them."""

    def __init__(self, archive: Archive, *, max_bytes: int = MAX_BYTES, min_free_bytes: int = MIN_FREE_BYTES) -> None:
        self._archive, self._max_bytes, self._min_free_bytes = archive, max_bytes, min_free_bytes
        _sweep()
        self._folder, self._handle = _locked_folder()
        self._lock = threading.Lock()
        self._sizes: OrderedDict[str, int] = OrderedDict()
        self._unwritten: dict[str, int] = {}
        self._used: Counter[str] = Counter()
        self._ended = threading.Event()

    def path(self, segment: str) -> Path:
        """Where the copy of a segment lies. segment: an id"""
        return self._folder / f"{segment}.mcap"

    def borrow(self, segment: str) -> Callable[[], None] | None:
        """Keep a copy that is here until the function that is returned is called; None if there is none."""
        with self._lock:
            if segment not in self._sizes or not self.path(segment).is_file():  # someone may have removed the file
                self._sizes.pop(segment, None)
                return None
            self._sizes.move_to_end(segment)
            self._used[segment] += 1

        def give_back() -> None:
            with self._lock:
                self._used -= Counter([segment])

        return give_back

    def make(self, segment: str, stop: threading.Event, known: Known | None = None) -> None:
        """Copy a segment. One call at a time for each segment. stop: set to give up;  known: what `segment_of` found

        Raises NoSegmentError, FullError, also if the disk here fails, SourceError if the segment is damaged, OSError of
        the archive, of these TimeoutError after `stop`.
        """

        def stopped() -> bool:
            return stop.is_set() or self._ended.is_set()

        commit, value = segment_of(self._archive, segment, stopped) if known is None else known
        size = value["bytes"]
        with _disk():
            self._make_room(segment, size)
        path = self.path(segment)
        part = path.with_suffix(".part")
        done = False
        try:
            with _disk():
                file = part.open("wb", buffering=0)
            try:
                self._fill(file, segment, value, stopped)
            finally:
                with _disk():
                    file.close()
            with _disk():
                # equal times for equal copies, so that a download goes on after the copy was made again
                os.utime(part, ns=(commit.last_ns, commit.last_ns))
                part.replace(path)
            done = True
        finally:
            with suppress(OSError):
                part.unlink(missing_ok=True)
            with self._lock:
                self._unwritten.pop(segment, None)
                if not done:
                    self._sizes.pop(segment, None)
                self._used -= Counter([segment])

    def _fill(self, file: FileIO, segment: str, value: dict[str, Any], stopped: Callable[[], bool]) -> None:
        """Write the recording of a segment. value: contents of its commit"""
        name, size = value["object"], value["bytes"]
        digest, count = hashlib.sha256(), 0
        for chunk in self._archive.store.chunks(name):
            if stopped():
                raise TimeoutError("the copy took too long")
            count += len(chunk)
            if count > size:
                break
            digest.update(chunk)
            with _disk():
                _write(file, chunk)
            with self._lock:
                self._unwritten[segment] = size - count
        if count != size or digest.hexdigest() != value["sha256"]:
            raise SourceError(f"{name} is damaged: its size or checksum is not the one that was written with it")

    def close(self) -> None:
        """Remove all copies. Those under way end soon."""
        self._ended.set()
        shutil.rmtree(self._folder, ignore_errors=True)
        handle, self._handle = self._handle, -1
        if handle >= 0:
            os.close(handle)

    def _make_room(self, segment: str, size: int) -> None:
        """Reserve room for a copy, which is in use then. Copies that nobody uses go, the oldest use first."""
        if size > self._max_bytes:
            raise FullError("the segment is too large for the server's space for copies: use `archive get` instead")
        with self._lock:
            for other in [one for one in self._sizes if not self._used[one]]:
                if self._fits(size):
                    break
                self.path(other).unlink(missing_ok=True)
                del self._sizes[other]
            if not self._fits(size):
                raise FullError("the server has no space for a copy of the segment: try again later")
            self._sizes[segment] = self._unwritten[segment] = size
            self._used[segment] += 1

    def _fits(self, size: int) -> bool:
        free = shutil.disk_usage(self._folder).free - sum(self._unwritten.values())
        return sum(self._sizes.values()) + size <= self._max_bytes and free - size >= self._min_free_bytes


@contextmanager
def _disk() -> Iterator[None]:
    """Errors of the disk here as FullError, so that they are not taken for those of the archive."""
    try:
        yield
    except OSError as error:
        full = error.errno in (errno.ENOSPC, errno.EDQUOT)
        told = "is full: try again later" if full else "failed; the log has the reason"
        raise FullError(f"the disk of the server {told}") from error


def _write(file: FileIO, data: bytes) -> None:
    left = memoryview(data)
    while left:
        left = left[file.write(left) :]


def _locked_folder() -> tuple[Path, int]:
    """A new folder, and the handle that keeps it locked. Raises OSError."""
    while True:
        folder = Path(tempfile.mkdtemp(prefix=PREFIX))
        handle = _lock(folder)
        if handle is not None:
            return folder, handle  # otherwise another server has just taken it for the folder of a dead one


def _lock(folder: Path) -> int | None:
    """A handle that keeps a folder locked; None if it is gone or belongs to a server that runs."""
    try:
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    except OSError:
        return None
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if os.fstat(handle).st_uid == os.geteuid() and os.path.samestat(os.fstat(handle), folder.lstat()):
            return handle
    except OSError:
        pass
    os.close(handle)
    return None


def _sweep() -> None:
    """Remove the folders of servers of this user that were killed."""
    for folder in Path(tempfile.gettempdir()).glob(f"{PREFIX}*"):
        handle = _lock(folder)
        if handle is not None:
            shutil.rmtree(folder, ignore_errors=True)
            os.close(handle)
