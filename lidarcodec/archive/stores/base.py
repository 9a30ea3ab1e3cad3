"""The interface of a store: objects by name, listed in order of their names, created whole or not at all.

>>> check_name("car-7/roof/drive.pcap")
'car-7/roof/drive.pcap'
>>> check_name("../secret.pcap")
Traceback (most recent call last):
lidarcodec.errors.SourceError: '../secret.pcap' is not the name of an object: it points outside of its folder
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final, NamedTuple

from lidarcodec.errors import SourceError

MAX_NAME: Final = 1024
"""Longest name of an object, in bytes, as in S3."""


class Entry(NamedTuple):
    """An object of a listing. tag: a text that changes with its content (ETag, or size and time of a file)"""

    name: str
    size: int
    tag: str


class Store(ABC):
    """Objects below a folder or a prefix. Names are relative, with `/` between their parts.

    url: what the store was opened with
    Methods raise FileNotFoundError for an object that does not exist, SourceError for a name that is not allowed, and
    other OSErrors if the store fails. Those may pass: try again later.
    """

    url: str

    def is_there(self) -> bool:
        """Whether it exists, as far as that can be seen: a prefix of a bucket always does."""
        return True

    @abstractmethod
    def entries(self, prefix: str = "", after: str = "") -> Iterator[Entry]:
        """Objects whose names begin with `prefix` (a folder, ending in `/`, or empty), in order of their names.

        after: only names greater than this one
        """

    @abstractmethod
    def read(self, name: str, start: int = 0, length: int | None = None) -> bytes:
        """Bytes of an object: all of them, or `length` bytes from `start`."""

    @abstractmethod
    def create(self, name: str, data: bytes | Path) -> bool:
        """Create an object whole, in one step. data: its bytes, or a file with them

        Returns False, and changes nothing, if the name is taken.
        """

    @abstractmethod
    def upload(self, name: str, chunks: Iterable[bytes]) -> None:
        """Write an object of many chunks. It appears when it is whole, and replaces an earlier one."""

    @abstractmethod
    def delete(self, name: str) -> None:
        """Delete an object. No error if there is none."""

    @abstractmethod
    def entry(self, name: str) -> Entry | None:
        """Size and tag of an object, as in a listing; None if there is none."""

    @abstractmethod
    def download(self, name: str, path: Path) -> None:
        """Write an object to a file."""

    def read_small(self, name: str, most: int) -> bytes:
        """All bytes of an object. Raises SourceError if it has more than `most`; then no more are read."""
        return self._checked(name, self.read(name, 0, most + 1), most)

    def _checked(self, name: str, data: bytes, most: int) -> bytes:
        if len(data) > most:
            raise SourceError(f"{name} has more than {most:,} bytes")
        return data

    def size(self, name: str) -> int | None:
        """Bytes of an object; None if there is none."""
        found = self.entry(name)
        return None if found is None else found.size

    def chunks(self, name: str, step: int = 8 << 20) -> Iterator[bytes]:
        """The bytes of an object in pieces of at most `step` bytes."""
        size = self.size(name)
        if size is None:
            raise FileNotFoundError(f"{self.url}: {name} does not exist")
        for start in range(0, size, step):
            yield self.read(name, start, min(step, size - start))

    def file(self, name: str) -> Path | None:
        """The file of an object, if the store is a folder."""
        del name
        return None

    def leftovers(self) -> Iterator[Path]:
        """Files of writers that were killed, if the store is a folder."""
        return iter(())


def check_name(name: str) -> str:
    """The name itself, if it can be the name of an object below a folder.

    Raises SourceError if it is empty or too long, leaves the folder, or has control characters.
    """
    parts = name.split("/")
    if ".." in parts or name.startswith(("/", "~")) or "\\" in name:
        raise SourceError(f"{name[:200]!r} is not the name of an object: it points outside of its folder")
    if "" in parts or "." in parts or not name.isprintable() or len(name.encode("utf-8", "replace")) > MAX_NAME:
        raise SourceError(f"{name[:200]!r} is not the name of an object: it is empty, too long or has odd characters")
    return name
