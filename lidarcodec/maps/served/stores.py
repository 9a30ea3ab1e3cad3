"""Stores of coded tiles, with limits: in a folder, which survives the process, and in memory. What was used last stays.

Both take parts of a piece until it is complete, so that a piece goes on where a lost link cut it off.
"""

from __future__ import annotations

import contextlib
import hashlib
import threading
from collections import OrderedDict
from pathlib import Path
from typing import Final, Protocol

from lidarcodec.errors import SourceError
from lidarcodec.files.piece_store import NAME, PieceStore

MAX_FILES: Final = 200_000
MAX_PARTS: Final = 16
"""Incomplete pieces in memory: so many are fetched at once. Others belong to tiles that have changed."""


class Pieces(Protocol):
    """Pieces by the SHA-256 of their bytes. One thread at a time may fetch a piece; several pieces may be fetched."""

    def has(self, name: str, size: int) -> bool: ...

    def got(self, name: str) -> int: ...

    def add(self, name: str, offset: int, data: bytes) -> None: ...

    def finish(self, name: str) -> bool: ...

    def read(self, name: str) -> bytes: ...


class MemoryPieces:
    """Pieces in memory of at most `max_bytes`, incomplete ones included, but always the newest."""

    def __init__(self, max_bytes: int) -> None:
        self._max_bytes = max_bytes
        self._lock = threading.Lock()
        self._held = 0
        self._whole: OrderedDict[str, bytes] = OrderedDict()
        self._parts: OrderedDict[str, bytearray] = OrderedDict()

    def has(self, name: str, size: int) -> bool:
        """Whether a piece is here."""
        return name in self._whole

    def got(self, name: str) -> int:
        """Bytes of a piece that are here although it is not complete."""
        with self._lock:
            return len(self._parts.get(name, b""))

    def add(self, name: str, offset: int, data: bytes) -> None:
        """Add bytes of a piece; what is behind `offset` is replaced."""
        with self._lock:
            part = self._parts.setdefault(name, bytearray())
            self._held -= len(part)
            part[offset:] = data
            self._held += len(part)
            self._parts.move_to_end(name)
            self._drop()

    def finish(self, name: str) -> bool:
        """Mark a piece as complete. False: its bytes were wrong, and are gone."""
        with self._lock:
            data = bytes(self._parts.pop(name, b""))
            self._held -= len(data)
            if hashlib.sha256(data).hexdigest() != name:
                return False
            if name not in self._whole:
                self._whole[name] = data
                self._held += len(data)
            self._drop()
            return True

    def read(self, name: str) -> bytes:
        """The bytes of a piece. Raises SourceError if it is not here."""
        with self._lock:
            if name not in self._whole:
                raise SourceError("the piece is no longer kept")
            self._whole.move_to_end(name)
            return self._whole[name]

    def _drop(self) -> None:
        """Keep the limits, but always the newest piece. Parts are of use yet, so complete pieces go first."""
        while len(self._parts) > MAX_PARTS:
            self._held -= len(self._parts.popitem(last=False)[1])
        for held in (self._whole, self._parts):
            while len(held) > 1 and self._held > self._max_bytes:
                self._held -= len(held.popitem(last=False)[1])


class FolderPieces(PieceStore):
    """Pieces in a folder of at most `max_bytes`, incomplete ones included, but always the newest.

    Several processes may share the folder, but not fetch one piece at once.

    Raises SourceError if the folder cannot be used.
    """

    def __init__(self, folder: Path, max_bytes: int) -> None:
        super().__init__(folder)
        self._max_bytes = max_bytes
        self._lock = threading.Lock()
        self._sizes: OrderedDict[str, int] = OrderedDict()
        for _, path, size in sorted(self._found()):
            self._sizes[path.stem] = size
        self._held = sum(self._sizes.values())

    def add(self, name: str, offset: int, data: bytes) -> None:
        """As of PieceStore; the pieces that were used least recently make room."""
        super().add(name, offset, data)
        self._use(name, offset + len(data))

    def finish(self, name: str) -> bool:
        """As of PieceStore."""
        if not super().finish(name):
            with self._lock:
                self._held -= self._sizes.pop(name, 0)
            return False
        with contextlib.suppress(OSError):
            self._use(name, self._path(name).stat().st_size)
        return True

    def read(self, name: str) -> bytes:
        """As of PieceStore."""
        data = super().read(name)
        with contextlib.suppress(OSError):
            self._path(name).touch()  # the next process finds out by this what was used last
        self._use(name, len(data))
        return data

    def clear(self) -> None:
        """Remove all pieces and parts, and the folder if nothing else is in it."""
        self.forget(path.stem for _, path, _ in self._found())
        with contextlib.suppress(OSError):
            self.folder.rmdir()

    def _use(self, name: str, size: int) -> None:
        with self._lock:
            self._held += size - self._sizes.get(name, 0)
            self._sizes[name] = size
            self._sizes.move_to_end(name)
            gone = []
            while len(self._sizes) > 1 and (self._held > self._max_bytes or len(self._sizes) > MAX_FILES):
                oldest, oldest_size = self._sizes.popitem(last=False)
                self._held -= oldest_size
                gone.append(oldest)
        self.forget(gone)

    def _found(self) -> list[tuple[int, Path, int]]:
        found = []
        try:
            for path in self.folder.iterdir() if self.folder.is_dir() else ():
                if NAME.fullmatch(path.stem) and path.suffix in (".piece", ".part"):
                    about = path.stat()
                    found.append((about.st_mtime_ns, path, about.st_size))
        except OSError as error:
            raise SourceError(f"the folder {self.folder} cannot be used: {error.strerror or error}") from None
        return found
