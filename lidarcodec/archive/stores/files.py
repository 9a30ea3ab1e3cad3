"""Objects of a store as files of fsspec, so that DuckDB reads them."""

from __future__ import annotations

import io
from datetime import UTC, datetime
from typing import Any

from fsspec import AbstractFileSystem

from lidarcodec.archive.stores.base import Store


class StoreFiles(AbstractFileSystem):  # type: ignore[misc]
    """Files `archive://NAME`. A table of frames is small: it is read whole, in one request."""

    protocol = "archive"
    cachable = False

    def __init__(self, store: Store) -> None:
        super().__init__()
        self._store = store

    def _open(self, path: str, mode: str = "rb", **options: Any) -> io.BytesIO:
        del mode, options
        return io.BytesIO(self._store.read(self._strip_protocol(path)))

    def info(self, path: str, **options: Any) -> dict[str, Any]:
        """Name, size and kind of a file."""
        del options
        name = self._strip_protocol(path)
        size = self._store.size(name)
        if size is None:
            raise FileNotFoundError(path)
        return {"name": name, "size": size, "type": "file"}

    def modified(self, path: str) -> datetime:
        """The same for all: an object never changes."""
        del path
        return datetime(1970, 1, 1, tzinfo=UTC)

    def glob(self, path: str, **options: Any) -> list[str]:
        """The path itself: names of tables are known."""
        del options
        return [str(self._strip_protocol(path))]
