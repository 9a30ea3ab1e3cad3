"""A folder as a store. Objects are files; they get their names when they are whole."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final

from lidarcodec.archive.stores.base import Entry, Store, check_name
from lidarcodec.errors import SettingsError, SourceError
from lidarcodec.files.regular import open_regular
from lidarcodec.files.whole import whole

_HIDDEN: Final = re.compile(r"\..{0,40}\.[0-9a-f]{12}(\.[A-Za-z0-9]+)?")
"""Names of outputs that are not whole yet (lidarcodec.files.whole)."""
_COPY: Final = 1 << 20


class FolderStore(Store):
    """Files below a folder. Hidden files are no objects; links that lead out of the folder are refused."""

    def __init__(self, root: Path) -> None:
        self._root = root.resolve()
        self.url = str(self._root)

    def is_there(self) -> bool:
        return self._root.is_dir()

    def entries(self, prefix: str = "", after: str = "") -> Iterator[Entry]:
        for entry, name in _walk(self._root, prefix, after):
            inside = not entry.is_symlink() or Path(entry.path).resolve().is_relative_to(self._root)
            try:
                found = entry.stat() if inside else None
            except OSError:  # removed meanwhile, or a broken link
                continue
            yield Entry(name, -1, "") if found is None else Entry(name, found.st_size, f"{found.st_mtime_ns}")

    def read(self, name: str, start: int = 0, length: int | None = None) -> bytes:
        with open_regular(self._path(name)) as file:
            file.seek(start)
            return file.read(-1 if length is None else length)

    def create(self, name: str, data: bytes | Path) -> bool:
        path = self._path(name)
        if os.path.lexists(path):
            return False
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            with whole(path) as output, output.beside.open("wb") as file:
                for chunk in (data,) if isinstance(data, bytes) else _pieces(data):
                    file.write(chunk)
        except (SettingsError, SourceError) as error:
            if os.path.lexists(path):  # another process was faster
                return False
            raise OSError(str(error)) from None  # a full disk: it may have room later
        return True

    def upload(self, name: str, chunks: Iterable[bytes]) -> None:
        path = self._path(name)
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            with whole(path, force=True) as output, output.beside.open("wb") as file:
                for chunk in chunks:
                    file.write(chunk)
        except (SettingsError, SourceError) as error:
            raise OSError(str(error)) from None

    def delete(self, name: str) -> None:
        self._path(name).unlink(missing_ok=True)

    def entry(self, name: str) -> Entry | None:
        try:
            found = self._path(name).stat()
        except (FileNotFoundError, NotADirectoryError):
            return None
        return Entry(name, found.st_size, f"{found.st_mtime_ns}")

    def download(self, name: str, path: Path) -> None:
        with path.open("wb") as file:
            for chunk in _pieces(self._path(name)):
                file.write(chunk)

    def file(self, name: str) -> Path | None:
        return self._path(name)

    def leftovers(self) -> Iterator[Path]:
        for folder, _, names in os.walk(self._root):
            yield from (Path(folder, name) for name in names if _HIDDEN.fullmatch(name))

    def _path(self, name: str) -> Path:
        path = self._root / check_name(name)
        if not path.resolve().is_relative_to(self._root):
            raise SourceError(f"{name!r} is a link that points outside of its folder")
        return path


def _walk(root: Path, prefix: str, after: str) -> Iterator[tuple[os.DirEntry[str], str]]:
    """Files below a folder in order of their names, as object stores list them: `a-b` comes before `a/b`."""
    try:
        with os.scandir(root / prefix) as found:
            entries = [(entry, entry.is_dir(follow_symlinks=False)) for entry in found if entry.name[:1] != "."]
    except (FileNotFoundError, NotADirectoryError):
        return
    for entry, folder in sorted(entries, key=lambda pair: pair[0].name + "/" * pair[1]):
        name = prefix + entry.name
        if folder:
            if f"{name}0" > after:  # "0" follows "/": some name in the folder may be greater
                yield from _walk(root, f"{name}/", after)
        elif name > after and (not entry.is_symlink() or not entry.is_dir()):
            yield entry, name


def _pieces(path: Path) -> Iterator[bytes]:
    with open_regular(path) as file:
        while chunk := file.read(_COPY):
            yield chunk
