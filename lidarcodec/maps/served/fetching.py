"""Fetches a map, or the tiles around a place, into a file. What was fetched stays in a folder until that is whole."""

from __future__ import annotations

import hashlib
import shutil
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Final

from lidarcodec.errors import DecodeError, SettingsError, SourceError, told
from lidarcodec.maps.file import MapWriter, path_of
from lidarcodec.maps.served.manifest import Manifest, Piece
from lidarcodec.maps.served.sources import MAX_CHANGES, ChangedMapError, TileSource
from lidarcodec.maps.tiles import place_in, points_in

IN_FLIGHT: Final = 4
SPARE_BYTES: Final = 16 * 2**20
"""Left free on a disk."""


@dataclass(frozen=True)
class Around:
    """Part of a map: tiles within a distance of a place, in metres."""

    x_m: float
    y_m: float
    radius_m: float


class MapFetch:
    """Fetches a map. `run` blocks; its state can be read from other threads.

    tiles, done: how many there are, and are here
    result: the list of tiles, and those of them that were wanted, in the order of the map; None until all are here
    """

    def __init__(self, source: TileSource, around: Around | None = None) -> None:
        """around: the part to fetch; by default everything"""
        self._source, self._around = source, around
        self._lock = threading.Lock()
        self.tiles, self.done = 0, 0
        self.result: tuple[Manifest, list[Piece]] | None = None

    def run(self, folder: Path) -> None:
        """Fetch everything. folder: on the disk that will hold it

        Raises SourceError, StoppedFetchError.
        """
        manifest = self._source.manifest()
        for _ in range(MAX_CHANGES):
            wanted = self._wanted(manifest)
            self._check_room(folder, sum(tile.size for tile in wanted))
            self.tiles, self.done = len(wanted), 0
            try:
                self._read_all([manifest.path, *wanted])
            except ChangedMapError:
                manifest = self._source.manifest(manifest)
            else:
                self.result = manifest, wanted
                return
        raise SourceError(f"map '{manifest.name}' changed {MAX_CHANGES} times while it was fetched")

    def _wanted(self, manifest: Manifest) -> list[Piece]:
        around = self._around
        if around is None:
            return list(manifest.tiles)
        near = {tile for _, tile in manifest.near(around.x_m, around.y_m, around.radius_m)}
        wanted = [tile for tile in manifest.tiles if tile in near]
        if not wanted:
            bounds = manifest.bounds_m
            where = "has no tiles" if bounds is None else "lies between x {} and y {}, x {} and y {}".format(*bounds)
            raise SettingsError(
                f"there is no tile within {around.radius_m:g} m of {around.x_m:g},{around.y_m:g}: map "
                f"'{manifest.name}' {where}",
                "around",
            )
        return wanted

    def _read_all(self, pieces: list[Piece]) -> None:
        """Fetch pieces, several at once. Raises the first error after the others have ended."""
        failed: list[Exception] = []
        waiting = iter(pieces)

        def work() -> None:
            while not failed:
                with self._lock:
                    piece = next(waiting, None)
                if piece is None:
                    return
                try:
                    self._source.read(piece)
                except BaseException as error:  # a panic of native code is not an Exception
                    failed.append(told(error))
                    return
                with self._lock:
                    self.done += piece.place is not None

        with ThreadPoolExecutor(IN_FLIGHT, "lidarcodec map fetch") as pool:
            for _ in range(IN_FLIGHT):
                pool.submit(work)
        if failed:
            raise failed[0]

    def _check_room(self, folder: Path, size: int) -> None:
        """Raise SourceError if a disk cannot hold the tiles, and the file made of them."""
        try:
            free = shutil.disk_usage(folder).free
        except OSError as error:
            raise SourceError(f"cannot use {folder}: {error.strerror or error}") from None
        if 2 * size + SPARE_BYTES > free:
            raise SourceError(
                f"the map needs {2 * size / 1e6:,.0f} MB on the disk of {folder}, but only {free / 1e6:,.0f} MB "
                "are free"
            )


def write_fetched(file: BinaryIO, manifest: Manifest, tiles: list[Piece], read: Callable[[Piece], bytes]) -> int:
    """Write a map of tiles that were fetched; with all of them it has the bytes of the original.

    file: empty, for writing and reading;  returns the number of points. Raises SourceError for a tile that is damaged,
    or not where the list says, for a damaged path, and for a whole map that is not the one of the list.
    """
    about = manifest.about
    writer, points = MapWriter(file, about.head), 0
    for tile in tiles:
        assert tile.place is not None
        data = read(tile)
        try:
            place, count = place_in(data), points_in(data)
        except DecodeError as error:
            raise _damaged(f"tile {tile.tail}", manifest, error) from None
        if place != tile.place:
            raise _damaged(f"tile {tile.tail}", manifest, "it is the tile of another place")
        writer.append(*place, data, count)
        points += count
    path = read(manifest.path)
    try:
        path_of(path, about.path_places)
    except DecodeError as error:
        raise _damaged("the path", manifest, error) from None
    writer.end(path, about.path_places, about.length_m)
    if len(tiles) == len(manifest.tiles):
        file.seek(0)
        digest = hashlib.file_digest(file, "sha256")  # type: ignore[arg-type]
        if digest.hexdigest() != manifest.version:
            raise SourceError(
                f"the tiles of map '{manifest.name}' do not match its list of tiles: the server sends them wrongly"
            )
        file.seek(0, 2)
    return points


def _damaged(what: str, manifest: Manifest, why: object) -> SourceError:
    return SourceError(f"{what} of map '{manifest.name}' is damaged at the server: {why}")
