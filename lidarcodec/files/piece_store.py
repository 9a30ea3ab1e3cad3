"""PieceStore: a folder of pieces that were fetched, each in a file named by the SHA-256 of its bytes.

A piece that is being fetched grows in `NAME.part`, and gets its name when its bytes match it. So a fetch goes on where
it was cut off, and what a power failure damaged is found out and fetched again.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from lidarcodec.errors import SourceError
from lidarcodec.files.regular import open_regular

NAME: Final = re.compile(r"[0-9a-f]{64}")


class PieceStore:
    """Pieces in a folder. For one fetch at a time for each piece.

    Raises SourceError if the folder cannot be written.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def has(self, name: str, size: int) -> bool:
        """Whether a piece is here."""
        try:
            return self._path(name).stat().st_size == size
        except OSError:
            return False

    def got(self, name: str) -> int:
        """Bytes of a piece that are here although it is not complete."""
        try:
            return self._part(name).stat().st_size
        except OSError:
            return 0

    def add(self, name: str, offset: int, data: bytes) -> None:
        """Add bytes of a piece. offset: of these bytes; what is behind it is replaced"""
        try:
            self.folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            with os.fdopen(os.open(self._part(name), os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600), "r+b") as file:
                file.truncate(offset)
                file.seek(offset)
                file.write(data)
        except OSError as error:
            raise self._unusable(error) from None

    def finish(self, name: str) -> bool:
        """Give a complete piece its name, on the disk by then. False: its bytes were wrong, and are gone."""
        part = self._part(name)
        try:
            with open_regular(part) as file:
                if hashlib.sha256(file.read()).hexdigest() != name:
                    part.unlink()
                    return False
                os.fsync(file.fileno())
            part.replace(self._path(name))
        except OSError as error:
            raise self._unusable(error) from None
        return True

    def read(self, name: str) -> bytes:
        """The bytes of a piece. Raises SourceError if it is not here, or damaged; then it is removed."""
        path = self._path(name)
        try:
            with open_regular(path) as file:
                data: bytes = file.read()
        except OSError as error:
            raise self._unusable(error) from None
        if hashlib.sha256(data).hexdigest() != name:
            path.unlink(missing_ok=True)
            raise SourceError("a fetched piece was damaged on the disk and removed: fetch again")
        return data

    def forget(self, names: Iterable[str]) -> None:
        """Remove pieces, and parts of them."""
        for name in names:
            for path in (self._path(name), self._part(name)):
                with contextlib.suppress(OSError):
                    path.unlink()

    def _path(self, name: str) -> Path:
        if not NAME.fullmatch(name):
            raise SourceError("this is not the name of a piece")
        return self.folder / f"{name}.piece"

    def _part(self, name: str) -> Path:
        return self._path(name).with_suffix(".part")

    def _unusable(self, error: OSError) -> SourceError:
        return SourceError(f"the folder of fetched pieces cannot be used: {error.strerror or error}")
