"""MapTiles: the tiles of a map around a position, fetched in the background from a file or from the network alike."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from types import TracebackType
from typing import Final, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import DecodeError, LidarCodecError, SettingsError, SourceError, told
from lidarcodec.maps.file import Head, path_of
from lidarcodec.maps.points import MapPoints
from lidarcodec.maps.served.manifest import Manifest, Piece
from lidarcodec.maps.served.sources import ChangedMapError, StoppedFetchError, TileSource
from lidarcodec.maps.tiles import Tile, decode_tile, points_in

logger = logging.getLogger(__name__)

LOOK_S: Final = 10.0
"""How often it is asked whether the map changed."""
LEAST_S: Final = 0.5
"""Shortest time between two such questions, when tiles are not those of the list."""
AGAIN_S: Final = 5.0
"""When a tile that could not be had is tried again."""
MARGIN_M: Final = 50.0
"""Tiles this much farther away than the radius are still held, so that a vehicle at a border does not fetch again."""
Place = tuple[int, int]


class FullError(SourceError):
    """There is no room for the points of a tile."""


class _Failure(NamedTuple):
    """Why a tile could not be had, and from when on it is tried again, in time.monotonic."""

    again_s: float
    why: str
    damaged: bool


@dataclass(frozen=True)
class TilesState:
    """State of the tiles around the position.

    here, missing: numbers of tiles within the radius;  points: that are held;  received: bytes from the network
    waiting: what is waited for, or None;  error: why the nearest missing tile, or the list, could not be had, or None
    """

    here: int
    missing: int
    points: int
    received: int
    waiting: str | None
    error: str | None


class MapTiles:
    """The tiles of a map around a position. Thread-safe; a context manager.

    Changes of the map are noticed within LOOK_S, and only tiles that changed are fetched.
    """

    def __init__(
        self,
        source: TileSource,
        *,
        radius_m: float = 150.0,
        max_points: int = 5_000_000,
        in_flight: int = 4,
        patience_s: float = 10.0,
        closing: Callable[[], object] = lambda: None,
    ) -> None:
        """radius_m: tiles within this distance of the position are held; infinity: the whole map
        max_points: points that are held, 30 bytes each; farther tiles are left out
        in_flight: tiles that are fetched at once;  closing: called at the end
        patience_s: longest time without any answer while the path is fetched

        Asks for the list of tiles, and blocks until it is there. Raises SourceError, SettingsError.
        """
        if not radius_m >= 0.0:
            raise SettingsError(f"the radius must be 0 m or more, not {radius_m} m", "radius")
        if not 1 <= in_flight <= 16:
            raise SettingsError("the number of tiles fetched at once must be 1 to 16", "in_flight")
        self._source, self._radius_m, self._max_points, self._closing = source, radius_m, max_points, closing
        self._patience_s = patience_s
        self._condition = threading.Condition()
        self._path_lock = threading.Lock()
        self._decoding = threading.Lock()
        self._stopped, self._stale = False, False
        self._position: tuple[float, float] | None = None
        self._wanted: list[Piece] = []
        self._here: dict[Place, tuple[str, Tile]] = {}
        self._busy: set[Place] = set()
        self._failed: dict[str, _Failure] = {}
        self._list_error: str | None = None
        self._points: tuple[int, MapPoints] | None = None
        self.serial = 0
        self._looked_s = time.monotonic()
        self._take(source.manifest())
        names = [f"lidarcodec map tile {at}" for at in range(in_flight)]
        self._threads = [threading.Thread(target=self._work, name=name, daemon=True) for name in names]
        self._threads.append(threading.Thread(target=self._look, name="lidarcodec map list", daemon=True))
        for thread in self._threads:
            thread.start()

    @property
    def name(self) -> str:
        """The name of the map."""
        return self._manifest.name

    @property
    def version(self) -> str:
        """SHA-256 of the map's file. It changes with the map."""
        return self._manifest.version

    @property
    def head(self) -> Head:
        """Step, columns and frame (UTM zone and origin) of the map."""
        return self._manifest.about.head

    @property
    def path(self) -> npt.NDArray[np.float32]:
        """(P, 3) metres: where the sensor was, about one place a metre; empty if the map has none.

        It is fetched when it is first asked for, which blocks. Raises SourceError, also after `patience_s` without any
        answer, and when `close` is called meanwhile.
        """
        manifest = self._manifest
        try:
            with self._path_lock:  # a piece is fetched by one thread at a time
                data = self._source.read(manifest.path, self._patience_s)
            return path_of(data, manifest.about.path_places)
        except StoppedFetchError:
            raise SourceError(f"map '{self.name}' was closed while its path was fetched") from None
        except DecodeError as error:
            raise SourceError(f"the path of map '{self.name}' cannot be decoded: {error}") from None

    @property
    def places(self) -> list[Place]:
        """All tiles of the map, in widths of a tile."""
        return list(self._manifest.by_place)

    @property
    def damaged(self) -> set[Place]:
        """Tiles around the position that cannot be decoded. They are tried again."""
        with self._condition:
            return {
                tile.place
                for tile in self._missing()
                if tile.place is not None and tile.hash in self._failed and self._failed[tile.hash].damaged
            }

    def move(self, x_m: float, y_m: float) -> None:
        """Hold the tiles around this position in the map, in metres. Returns at once.

        Raises SettingsError for a position that is not finite.
        """
        if not (math.isfinite(x_m) and math.isfinite(y_m)):
            raise SettingsError("a position in a map must have finite numbers", "position")
        with self._condition:
            self._position = float(x_m), float(y_m)
            self._choose()
            self._condition.notify_all()

    def wait(self, timeout_s: float) -> bool:
        """Wait until all tiles around the position are here; whether they are. After `move` only."""
        with self._condition:
            self._condition.wait_for(lambda: self._stopped or not self._missing(), timeout_s)
            return not self._missing()

    def points(self) -> MapPoints:
        """The points of the tiles that are here, with normals and columns as in the map, and without its path."""
        with self._condition:
            if self._points is not None and self._points[0] == self.serial:
                return self._points[1]
            serial, head = self.serial, self.head
            tiles = [tile for _, (_, tile) in sorted(self._here.items())]
        steps = np.concatenate([tile.steps for tile in tiles]) if tiles else np.empty((0, 3), np.int64)
        columns = {
            name: np.concatenate([tile.columns[:, at] for tile in tiles]) if tiles else np.empty(0, np.uint16)
            for at, name in enumerate(head.columns)
        }
        found = MapPoints(head.step_m, steps, columns, frame=head.frame)
        with self._condition:
            self._points = serial, found
        return found

    def state(self) -> TilesState:
        """How far it is."""
        with self._condition:
            wanted, missing = self._wanted, self._missing()
            errors = [self._failed[tile.hash].why for tile in missing if tile.hash in self._failed]
            error = (errors[0] if errors else self._list_error) if missing else None
            here, source = len(wanted) - len(missing), self._source
            return TilesState(here, len(missing), self._held(), source.received, source.waiting, error)

    def close(self) -> None:
        """End everything. A second call does nothing."""
        with self._condition:
            self._stopped = True
            self._condition.notify_all()
        self._source.stop()
        for thread in self._threads:
            if thread is not threading.current_thread():
                thread.join(10.0)
        closing, self._closing = self._closing, lambda: None
        closing()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    # --- what is wanted; the condition is held ------------------------------------------------------------------------

    def _take(self, manifest: Manifest) -> None:
        """Go over to a list of tiles; those that did not change stay."""
        before = getattr(self, "_manifest", manifest)
        self._manifest = manifest
        self._tiles = manifest.by_place
        alike = before.about.head == manifest.about.head  # another head decodes the same bytes otherwise
        kept = {
            place: (name, tile)
            for place, (name, tile) in self._here.items()
            if alike and place in self._tiles and self._tiles[place].hash == name
        }
        if len(kept) < len(self._here) or not alike:
            self.serial += 1
        self._here, self._failed = kept, {}
        self._choose()

    def _choose(self) -> None:
        """Find out which tiles are wanted around the position, the nearest first, and drop those that are far."""
        if self._position is None:
            return
        near = self._manifest.near(*self._position, self._radius_m + MARGIN_M)
        self._wanted = [tile for away, tile in near if away <= self._radius_m]
        self._drop_others(tile for _, tile in near)

    def _drop_others(self, kept: Iterable[Piece]) -> None:
        gone = self._here.keys() - {tile.place for tile in kept}
        for place in gone:
            del self._here[place]
        if gone:
            self.serial += 1
            self._failed = {name: one for name, one in self._failed.items() if one.again_s < math.inf}

    def _missing(self) -> list[Piece]:
        return [tile for tile in self._wanted if tile.place not in self._here]

    def _next(self) -> Piece | None:
        """The nearest tile that is missing, and that nobody fetches."""
        now_s = time.monotonic()
        for tile in self._missing():
            failed = self._failed.get(tile.hash)
            if tile.place not in self._busy and (failed is None or failed.again_s <= now_s):
                return tile
        return None

    # --- threads ------------------------------------------------------------------------------------------------------

    def _work(self) -> None:
        while True:
            with self._condition:
                while not self._stopped and (tile := self._next()) is None:
                    self._condition.wait(AGAIN_S if self._failed else None)
                if self._stopped:
                    return
                assert tile is not None
                assert tile.place is not None
                place = tile.place
                self._busy.add(place)
                head = self.head
            try:
                data = self._source.read(tile)
                with self._decoding:  # one at a time: it may take memory for millions of points
                    self._put(tile, head, data)
            except StoppedFetchError:
                return
            except BaseException as failure:  # a panic of native code is not an Exception
                with self._condition:
                    self._put_off(tile, told(failure))
            with self._condition:
                self._busy.discard(place)
                self._condition.notify_all()

    def _put(self, tile: Piece, head: Head, data: bytes) -> None:
        """Decode a tile, and hold it. Raises DecodeError, SourceError, FullError."""
        if not self._room_for(points_in(data)):
            raise FullError(
                f"the tiles within {self._radius_m:g} m have more than {self._max_points:,} points: farther ones are "
                "left out"
            )
        found = decode_tile(data, head.width, head.bits)
        place = found.x, found.y
        if place != tile.place:
            raise SourceError(f"the fetched tile {tile.tail} of map '{self.name}' does not match the list of tiles")
        with self._condition:
            if self._tiles.get(place) == tile and head == self.head:
                self._here[place] = tile.hash, found
                self._failed.pop(tile.hash, None)
                self.serial += 1

    def _put_off(self, tile: Piece, error: Exception) -> None:
        """Try a tile again later; one without room when others have gone."""
        self._stale = self._stale or isinstance(error, ChangedMapError)
        again_s = math.inf if isinstance(error, FullError) else time.monotonic() + AGAIN_S
        why = str(error) if isinstance(error, LidarCodecError) else f"{type(error).__name__}: {error}"
        if all(why != one.why for one in self._failed.values()):
            logger.warning("%s", why)
        self._failed[tile.hash] = _Failure(again_s, why, isinstance(error, DecodeError))

    def _room_for(self, points: int) -> bool:
        """Whether so many points more may be held."""
        with self._condition:
            if points + self._held() > self._max_points:
                self._drop_others(self._wanted)
            return points + self._held() <= self._max_points

    def _held(self) -> int:
        return sum(len(tile.steps) for _, tile in self._here.values())

    def _look(self) -> None:
        while True:
            with self._condition:
                self._condition.wait_for(
                    lambda: self._stopped or self._stale, max(0.0, self._looked_s + LOOK_S - time.monotonic())
                )
                if self._stopped:
                    return
                self._stale = False
                have = self._manifest
            error: str | None = None
            try:
                fresh = self._source.manifest(have)
            except StoppedFetchError:
                return
            except BaseException as failure:
                fresh, error = have, str(told(failure))
                logger.debug("the list of tiles: %s", error)
            self._looked_s = time.monotonic()
            with self._condition:
                self._list_error = error
                if fresh is not have:
                    logger.info("map '%s' changed to version %.12s", fresh.name, fresh.version)
                    self._take(fresh)
                    self._condition.notify_all()
                self._condition.wait_for(lambda: self._stopped, LEAST_S)
