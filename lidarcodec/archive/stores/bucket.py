"""Object storage as a store, through obstore (extra `archive`)."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from datetime import timedelta
from pathlib import Path
from typing import Any, Final, TypeVar

from lidarcodec.archive.stores.base import Entry, Store, check_name
from lidarcodec.errors import SourceError

_PAGE: Final = 1000
_RETRIES: Final = 8
"""Repetitions of a request that the store may answer later (errors 500 and 503, cut connections)."""

_PAUSES_S: Final = (0.5, 2.0)
"""Pauses before each repetition of a request whose answer was cut."""
Result = TypeVar("Result")
_asked_by: int | None = None
"""The first process that used obstore. obstore hangs in processes that are forked from it."""


def _check_process() -> None:
    """Raise SourceError in a process in which obstore would hang."""
    global _asked_by  # noqa: PLW0603
    _asked_by = _asked_by or os.getpid()
    if _asked_by != os.getpid():
        raise SourceError(
            "object storage cannot be used in a forked process: start it with `spawn`, such as "
            "DataLoader(..., multiprocessing_context='spawn')"
        )


class BucketStore(Store):
    """Objects below a prefix of a bucket: `s3://BUCKET/PREFIX`, `gs://...`, `az://...`.

    Keys, region and endpoint come from the environment, as for other programs (`AWS_ACCESS_KEY_ID`,
    `AWS_ENDPOINT_URL`, `GOOGLE_APPLICATION_CREDENTIALS`, `AZURE_STORAGE_ACCOUNT_NAME`, ...).
    """

    def __init__(self, url: str, retry_s: int = 90) -> None:
        """retry_s: how long a request is repeated. Raises SourceError if the address cannot be used."""
        import obstore.store
        from obstore.exceptions import BaseError

        self.url = url
        try:
            retries: Any = {"max_retries": _RETRIES, "retry_timeout": timedelta(seconds=retry_s)}
            self._store = obstore.store.from_url(url, retry_config=retries)
        except (BaseError, ValueError) as error:
            raise SourceError(f"{url} cannot be opened: {_told(error)}") from None

    def entries(self, prefix: str = "", after: str = "") -> Iterator[Entry]:
        pauses_s = list(_PAUSES_S)
        while True:
            try:
                for entry in self._listed(prefix, after):
                    yield entry
                    after = entry.name
            except FileNotFoundError:
                raise
            except OSError:
                if not pauses_s:
                    raise
                time.sleep(pauses_s.pop(0))
            else:
                return

    def _listed(self, prefix: str, after: str) -> Iterator[Entry]:
        import obstore

        with self._errors(prefix):
            pages = obstore.list(self._store, prefix or None, offset=after or None, chunk_size=_PAGE)
            for page in pages:
                for found in sorted(page, key=lambda one: one["path"]):
                    yield _entry(found)

    def read(self, name: str, start: int = 0, length: int | None = None) -> bytes:
        if length is None and start:
            raise ValueError("the length of a byte range must be given")
        return self._again(lambda: self._read(name, start, length))

    def _read(self, name: str, start: int, length: int | None) -> bytes:
        import obstore

        with self._errors(name):
            if length is None:
                return bytes(obstore.get(self._store, check_name(name)).bytes())
            return bytes(obstore.get_range(self._store, check_name(name), start=start, length=length))

    def read_small(self, name: str, most: int) -> bytes:
        return self._checked(name, self._again(lambda: self._read_small(name, most)), most)

    def _read_small(self, name: str, most: int) -> bytes:
        import obstore

        data = bytearray()
        with self._errors(name):
            for chunk in obstore.get(self._store, check_name(name)):  # one request, an empty object included
                data += bytes(chunk)[: most + 1 - len(data)]
                if len(data) > most:
                    break
        return bytes(data)

    def create(self, name: str, data: bytes | Path) -> bool:
        """As of Store. It may also return False if an earlier attempt, whose answer was cut, created the object."""
        return self._again(lambda: self._create(name, data))

    def _create(self, name: str, data: bytes | Path) -> bool:
        import obstore
        from obstore.exceptions import AlreadyExistsError

        with self._errors(name):
            try:
                obstore.put(self._store, check_name(name), data, mode="create", use_multipart=False)
            except AlreadyExistsError:
                return False
            return True

    def upload(self, name: str, chunks: Iterable[bytes]) -> None:
        import obstore

        with self._errors(name):
            obstore.put(self._store, check_name(name), iter(chunks), max_concurrency=1)

    def delete(self, name: str) -> None:
        with suppress(FileNotFoundError):  # some stores say so, also of what an attempt deleted whose answer was cut
            self._again(lambda: self._delete(name))

    def _delete(self, name: str) -> None:
        import obstore

        with self._errors(name):
            obstore.delete(self._store, check_name(name))

    def entry(self, name: str) -> Entry | None:
        try:
            return self._again(lambda: self._entry(name))
        except FileNotFoundError:
            return None

    def _entry(self, name: str) -> Entry:
        import obstore

        with self._errors(name):
            return _entry(obstore.head(self._store, check_name(name)))._replace(name=name)

    def download(self, name: str, path: Path) -> None:
        self._again(lambda: self._download(name, path))

    def _download(self, name: str, path: Path) -> None:
        import obstore

        with self._errors(name), path.open("wb") as file:
            for chunk in obstore.get(self._store, check_name(name)):
                file.write(chunk)

    @staticmethod
    def _again(asked: Callable[[], Result]) -> Result:
        """What `asked` returns. obstore repeats requests, but not all whose connection was cut."""
        for pause_s in _PAUSES_S:
            try:
                return asked()
            except FileNotFoundError:
                raise
            except OSError:
                time.sleep(pause_s)
        return asked()

    @contextmanager
    def _errors(self, name: str) -> Iterator[None]:
        from obstore.exceptions import BaseError

        _check_process()
        try:
            yield
        except FileNotFoundError:
            raise FileNotFoundError(f"{self.url}: {name} does not exist") from None
        except BaseError as error:
            told = _told(error)
            if "invalid path" in told:  # a listing with such a name cannot be read
                raise SourceError(
                    f"{self.url} has an object with an empty name, or one that points outside of its prefix: "
                    f"delete it first ({told})"
                ) from None
            raise OSError(f"{self.url}: {told}") from None


def _entry(found: Any) -> Entry:
    return Entry(found["path"], int(found["size"]), (found["e_tag"] or "").strip('"'))


def _told(error: Exception) -> str:
    """The first line of an error of obstore, which adds its source code's own."""
    lines = str(error).strip().splitlines() or [type(error).__name__]
    return lines[0][:300]
