"""MapShelf: the maps in files and folders, by name. A file that changes is read again within a second.

A file is replaced by renaming another one to its name (`map build --force` and `map compress --force` do that). The
shelf keeps the old map while the new file cannot be read. The name of a map is that of its file without `.lcmap`.
"""

from __future__ import annotations

import hashlib
import logging
import os
import threading
import weakref
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from lidarcodec.errors import DecodeError, SettingsError, SourceError
from lidarcodec.files.regular import open_regular
from lidarcodec.maps.file import HEAD_BYTES, MapReader
from lidarcodec.maps.served.manifest import MAX_TILE_BYTES, MAX_TILES, Manifest, Piece, check_map_name

logger = logging.getLogger(__name__)

ENDING: Final = ".lcmap"
MAX_MAPS: Final = 256
LOOK_S: Final = 1.0
_PART: Final = 1 << 20
Identity = tuple[int, int, int, int]


class ShelvedMap:
    """A map in a file that stays open, so that its tiles belong together whatever happens to the name of the file.

    identity: of the file
    """

    def __init__(self, name: str, path: Path) -> None:
        """Raises SourceError if there is no map that can be served."""
        self.name = check_map_name(name)
        try:
            with open_regular(path) as file:
                found = os.fstat(file.fileno())
                self.identity: Identity = _identity(found)
                reader = MapReader(file)
                largest = max((place.size for place in reader.places), default=0)
                if len(reader.places) > MAX_TILES or largest > MAX_TILE_BYTES:
                    raise SourceError(
                        f"{path} is too large to be served: a map has at most {MAX_TILES:,} tiles of "
                        f"{MAX_TILE_BYTES:,} bytes"
                    )
                self._offsets: dict[tuple[int, int] | None, int] = {}
                self._handle = os.dup(file.fileno())
        except OSError as error:
            raise SourceError(f"cannot read {path}: {error.strerror or error}") from None
        except DecodeError as error:
            raise SourceError(f"cannot read the map {path}: {error}") from None
        weakref.finalize(self, os.close, self._handle)
        self._whole = hashlib.sha256(head := self._read(0, HEAD_BYTES))
        tiles = tuple(self._piece((place.x, place.y), place.offset, place.size) for place in reader.places)
        about = reader.about
        path_piece = self._piece(None, about.path_at, about.index_at - about.path_at)
        self._piece(None, about.index_at, found.st_size - about.index_at)
        self._offsets[None] = about.path_at
        self.manifest = Manifest(name, self._whole.hexdigest(), head, about, path_piece, tiles)
        self.pieces: dict[tuple[int, int] | None, Piece] = {tile.place: tile for tile in tiles} | {None: path_piece}

    def changed(self, path: Path) -> bool:
        """Whether another file is at a path now. Raises SourceError if there is none."""
        try:
            return _identity(path.stat()) != self.identity
        except OSError as error:
            raise SourceError(f"cannot read {path}: {error.strerror or error}") from None

    def read(self, piece: Piece, offset: int = 0, size: int | None = None) -> bytes:
        """Bytes of a piece of the manifest. Raises SourceError if the disk does not give them, or gives others, as
        where the file was overwritten. Of a part the receiver finds that out.
        """
        left = piece.size - offset
        data = self._read(self._offsets[piece.place] + offset, left if size is None else min(size, left))
        if len(data) == piece.size and hashlib.sha256(data).hexdigest() != piece.hash:
            raise SourceError(
                f"the file of map '{self.name}' was overwritten while it was served: put a new map in its place by "
                "renaming"
            )
        return data

    def _piece(self, place: tuple[int, int] | None, offset: int, size: int) -> Piece:
        self._offsets[place] = offset
        digest = hashlib.sha256()
        for at in range(offset, offset + size, _PART):
            part = self._read(at, min(_PART, offset + size - at))
            digest.update(part)
            self._whole.update(part)
        return Piece(place, size, digest.hexdigest())

    def _read(self, offset: int, size: int) -> bytes:
        try:
            data = os.pread(self._handle, size, offset)
        except OSError as error:
            raise SourceError(f"the map '{self.name}' cannot be read: {error.strerror or error}") from None
        if len(data) < size:
            raise SourceError(f"the file of map '{self.name}' became shorter while it was served")
        return data


class MapShelf:
    """Maps by name. `start` begins to look for changes, until `close`; both may be left out."""

    def __init__(self, paths: Sequence[Path]) -> None:
        """paths: files, which must be maps, and folders, whose files are maps once they can be read

        Raises SourceError, SettingsError if two files have one name.
        """
        self._paths = list(paths)
        self._maps: dict[str, ShelvedMap] = {}
        self._failed: dict[Path, Identity] = {}
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        for path in self._paths:
            if not path.is_dir() and path.suffix.lower() != ENDING:
                raise SettingsError(f"{path} is neither a map ({ENDING}) nor a folder of maps")
            if not path.is_dir():
                if path.stem in self._maps:
                    raise SettingsError(f"two maps have the name '{path.stem}': rename one of the files")
                self._maps[path.stem] = ShelvedMap(path.stem, path)
        self.refresh()

    def start(self) -> None:
        """Look for changes from now on, in a thread."""
        self._thread = threading.Thread(target=self._watch, name="lidarcodec maps", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop looking. A second call does nothing."""
        self._stop.set()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(10.0)

    def get(self, name: str) -> ShelvedMap | None:
        """A map; None if there is none of this name."""
        return self._maps.get(name)

    def all(self) -> list[ShelvedMap]:
        """All maps, by name."""
        return [one for _, one in sorted(self._maps.items())]

    def refresh(self) -> None:
        """Look for new, changed and removed files now."""
        found: dict[str, ShelvedMap] = {}
        for path in self._files():
            if path.stem in found:
                self._warn_once(path, "another map has this name already")
            elif len(found) >= MAX_MAPS:
                self._warn_once(path, f"at most {MAX_MAPS} maps are served")
            elif (shelved := self._current(path)) is not None:
                found[path.stem] = shelved
        for name in self._maps.keys() - found.keys():
            logger.info("map '%s' is no longer served: its file is gone", name)
        self._maps = found

    def _current(self, path: Path) -> ShelvedMap | None:
        """The map that is in a file now; the one before if it cannot be read."""
        before = self._maps.get(path.stem)
        try:
            identity = _identity(path.stat())
        except OSError:
            return None
        if before is not None and before.identity == identity:
            return before
        if self._failed.get(path) == identity:
            return before
        try:
            fresh = ShelvedMap(path.stem, path)
        except SourceError as error:
            self._failed[path] = identity
            logger.warning("%s%s", error, "" if before is None else "; the map before is still served")
            return before
        self._failed.pop(path, None)
        tiles, version = len(fresh.manifest.tiles), fresh.manifest.version
        logger.info("map '%s' has %d tiles, version %.12s", fresh.name, tiles, version)
        return fresh

    def _files(self) -> list[Path]:
        """The files that may be maps. Hidden ones are being written."""
        found: list[Path] = []
        for path in self._paths:
            if not path.is_dir():
                found.append(path)
                continue
            try:
                inside = sorted(path.iterdir())
            except OSError as error:
                logger.debug("%s: %s", path, error)
                continue
            found += [one for one in inside if one.suffix.lower() == ENDING and not one.name.startswith(".")]
        self._failed = {path: identity for path, identity in self._failed.items() if path in found}
        return found

    def _warn_once(self, path: Path, reason: str) -> None:
        nowhere = (0, 0, 0, 0)
        if self._failed.get(path) != nowhere:
            self._failed[path] = nowhere
            logger.warning("%s is not served: %s", path, reason)

    def _watch(self) -> None:
        while not self._stop.wait(LOOK_S):
            try:
                self.refresh()
            except Exception:
                logger.exception("looking for changed maps failed and will be tried again")


def _identity(found: os.stat_result) -> Identity:
    return found.st_dev, found.st_ino, found.st_mtime_ns, found.st_size
