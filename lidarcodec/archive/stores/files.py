"""Objects of a store as files of fsspec, so that DuckDB reads them."""

from __future__ import annotations

import io
from datetime import UTC, datetime
from typing import Any, Final

from fsspec import AbstractFileSystem
from fsspec.spec import AbstractBufferedFile

from lidarcodec.archive.stores.base import Store

WHOLE_BYTES: Final = 1 << 20
"""A file of at most so many bytes is read in one request."""


class StoreFile(AbstractBufferedFile):  # type: ignore[misc]
    """A large object, read in parts."""

    def _fetch_range(self, start: int, end: int) -> bytes:
        return self.fs.part(self.path, start, end)  # type: ignore[no-any-return]


class StoreFiles(AbstractFileSystem):  # type: ignore[misc]
    """Files `archive://NAME`. A small one is read whole, of a large one only the parts that are asked for."""

    protocol = "archive"
    cachable = False

    def __init__(self, store: Store) -> None:
        super().__init__()
        self._store = store
        self._sizes: dict[str, int] = {}

    def _open(self, path: str, mode: str = "rb", **options: Any) -> io.BytesIO | StoreFile:
        del options
        name = str(self._strip_protocol(path))
        size = self.info(name)["size"]
        if size <= WHOLE_BYTES:
            return io.BytesIO(self._store.read(name))
        return StoreFile(self, name, mode, block_size=WHOLE_BYTES, cache_type="readahead", size=size)

    def part(self, name: str, start: int, end: int) -> bytes:
        """Bytes of an object."""
        return self._store.read(name, start, end - start)

    def info(self, path: str, **options: Any) -> dict[str, Any]:
        """Name, size and kind of a file. The store is asked once: an object never changes."""
        del options
        name = str(self._strip_protocol(path))
        if name not in self._sizes:
            size = self._store.size(name)
            if size is None:
                raise FileNotFoundError(path)
            self._sizes[name] = size
        return {"name": name, "size": self._sizes[name], "type": "file"}

    def modified(self, path: str) -> datetime:
        """The same for all: an object never changes."""
        del path
        return datetime(1970, 1, 1, tzinfo=UTC)

    def glob(self, path: str, **options: Any) -> list[str]:
        """The path itself: names of tables are known."""
        del options
        return [str(self._strip_protocol(path))]
