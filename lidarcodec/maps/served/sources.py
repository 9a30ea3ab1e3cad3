"""Where tiles come from: a file, or a process that serves maps on the network. Both have the interface TileSource."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, Final, Protocol

from lidarcodec.errors import LidarCodecError, SourceError
from lidarcodec.maps.served.answers import HEAD, PART
from lidarcodec.maps.served.manifest import KEY, MAX_TILES, SUMMARY, Manifest, Piece, check_map_name, manifest_of
from lidarcodec.maps.served.shelf import MAX_MAPS, ShelvedMap
from lidarcodec.maps.served.stores import Pieces
from lidarcodec.settings import is_name
from lidarcodec.transport import Transport
from lidarcodec.transport.asking import ANSWER_S, reason_of, retry_of, until_answered
from lidarcodec.transport.base import MAX_EVENT_BYTES
from lidarcodec.transport.part_size import PartSize
from lidarcodec.untrusted.json import JsonRefusedError, read_object

logger = logging.getLogger(__name__)

MAX_WRONG: Final = 3
"""Most times that a tile may come with the wrong bytes."""
MAX_CHANGES: Final = 10
"""Most times that a map may change while its list of tiles is fetched."""

MOST_TEXT, MOST_NUMBERS = 64, 4
"""Of a field of a map in a list of maps: its version has 64 characters, its bounds are four numbers."""


class ChangedMapError(SourceError):
    """A tile is not the one of the list any more: ask for the list again."""


class StoppedFetchError(LidarCodecError):
    """The fetch was stopped; what was fetched is still there."""


class TileSource(Protocol):
    """Gives the list of tiles of one map, and their bytes. Thread-safe; methods block, until `stop`.

    received: bytes that came over the network;  waiting: what is waited for, as text; None if for nothing
    """

    received: int
    waiting: str | None

    def manifest(self, have: Manifest | None = None) -> Manifest:
        """The list of tiles as it is now; `have` itself if nothing changed. Raises SourceError."""

    def read(self, piece: Piece, patience_s: float | None = None) -> bytes:
        """The bytes of a tile, or of the path. patience_s: longest time without any answer; by default the source's

        Raises ChangedMapError, SourceError.
        """

    def stop(self) -> None:
        """End what blocks with StoppedFetchError, and give back what is held."""


class FileTiles:
    """A map in a file. A file that takes its place is noticed."""

    def __init__(self, path: Path) -> None:
        """Raises SourceError."""
        self._path, self._shelved = path, ShelvedMap(path.stem, path)
        self.received = 0
        self.waiting: str | None = None

    def manifest(self, have: Manifest | None = None) -> Manifest:
        """As of TileSource; the one before while the file cannot be read."""
        if have is not None:
            try:
                if self._shelved.changed(self._path):
                    self._shelved = ShelvedMap(self._shelved.name, self._path)
            except SourceError as error:
                logger.debug("%s; the map before is used", error)
        return self._shelved.manifest

    def read(self, piece: Piece, patience_s: float | None = None) -> bytes:
        """As of TileSource."""
        shelved = self._shelved
        if shelved.pieces.get(piece.place) != piece:
            raise ChangedMapError("the map has changed")
        return shelved.read(piece)

    def stop(self) -> None:
        """Nothing blocks."""


class NetworkTiles:
    """A map that another process serves.

    transport:  gives the network session, or raises TransportError while there is none
    store:      keeps pieces, and parts of them
    patience_s: longest time without any answer
    tiles:      that came over the network
    """

    def __init__(self, name: str, transport: Callable[[], Transport], store: Pieces, patience_s: float) -> None:
        """Raises SourceError if no map can have this name."""
        self.name = check_map_name(name)
        self._transport, self._store, self.patience_s = transport, store, patience_s
        self._parts, self._stop = PartSize(), threading.Event()
        self._lock = threading.Lock()
        self._turns, self._reading = threading.Condition(), set[str]()
        self._answered_s = time.monotonic()
        self.received = self.tiles = 0
        self.waiting: str | None = None

    def manifest(self, have: Manifest | None = None) -> Manifest:
        """As of TileSource. Raises SilentError as SourceError if nobody answers for too long."""
        for _ in range(MAX_CHANGES):
            first = self._told({"have": have.version} if have is not None else {})
            if have is not None and first.get("same") is True and first.get("version") == have.version:
                return have
            try:
                return manifest_of(self.name, self._pages(first))
            except ChangedMapError:
                continue
        raise SourceError(f"map '{self.name}' changed {MAX_CHANGES} times while its list of tiles was fetched")

    def read(self, piece: Piece, patience_s: float | None = None) -> bytes:
        """As of TileSource. Parts that are here are not fetched again."""
        with self._turn(piece.hash):
            return self._read(piece, patience_s)

    @contextmanager
    def _turn(self, name: str) -> Iterator[None]:
        """A piece is fetched by one thread at a time; others then find it in the store."""
        with self._turns:
            while name in self._reading:
                if self._stop.is_set():
                    raise StoppedFetchError("the fetch was stopped")
                self._turns.wait(0.2)
            self._reading.add(name)
        try:
            yield
        finally:
            with self._turns:
                self._reading.discard(name)
                self._turns.notify_all()

    def _read(self, piece: Piece, patience_s: float | None) -> bytes:
        for _ in range(MAX_WRONG):
            if not self._store.has(piece.hash, piece.size):
                offset = min(self._store.got(piece.hash), piece.size)
                while offset < piece.size:
                    data = self._part(piece, offset, patience_s)
                    self._store.add(piece.hash, offset, data)
                    offset += len(data)
                if not self._store.finish(piece.hash):
                    logger.warning("tile %s of map '%s' arrived damaged", piece.tail, self.name)
                    continue
                with self._lock:
                    self.tiles += piece.place is not None
            data = self._store.read(piece.hash)
            if len(data) == piece.size:
                return data
        raise SourceError(f"tile {piece.tail} of map '{self.name}' arrived damaged {MAX_WRONG} times")

    def stop(self) -> None:
        """As of TileSource."""
        self._stop.set()

    def _pages(self, page: dict[str, Any]) -> Iterator[dict[str, Any]]:
        """The pages of a list of tiles from the first on, each asked for when the one before was used."""
        version, wanted, listed = page.get("version"), _tiles_of(page), 0
        while True:
            yield page
            count = _counted(page)
            listed += count
            if not count or listed >= wanted:
                return
            page = self._told({"from": listed})
            if page.get("version") != version:
                raise ChangedMapError(f"map '{self.name}' has changed")

    def _part(self, piece: Piece, offset: int, patience_s: float | None) -> bytes:
        size = min(self._parts.bytes, piece.size - offset)
        question = {"hash": piece.hash, "offset": offset, "bytes": size}
        answer, took_s = self._ask(f"{KEY}/{self.name}/{piece.tail}", question, patience_s)
        if not answer or answer[0] != PART:
            told = _object(answer)
            if told.get("field") == "tile":
                raise ChangedMapError(f"map '{self.name}' no longer has tile {piece.tail}")
            raise SourceError(f"map '{self.name}' is refused: {reason_of(told)}")
        if not HEAD.size < len(answer) <= HEAD.size + size:
            raise SourceError(f"the answer about tile {piece.tail} of map '{self.name}' cannot be understood")
        _, whole, at, digest = HEAD.unpack_from(answer)
        if digest.hex() != piece.hash:
            raise ChangedMapError(f"tile {piece.tail} of map '{self.name}' has changed")
        if (whole, at, len(answer) - HEAD.size) != (piece.size, offset, size):  # a byte each would go on for good
            raise SourceError(f"the answer about tile {piece.tail} of map '{self.name}' cannot be understood")
        self._parts.took(size, took_s)
        with self._lock:
            self.received += len(answer)
        return answer[HEAD.size :]

    def _told(self, question: dict[str, Any]) -> dict[str, Any]:
        """The answer to a question about the list of tiles."""
        begun_s = time.monotonic()
        while True:
            told = _object(self._ask(f"{KEY}/{self.name}", question)[0])
            if "error" not in told:
                return told
            retry_s = retry_of(told)
            if retry_s is None or time.monotonic() - begun_s > self.patience_s:
                raise SourceError(f"map '{self.name}' is refused: {reason_of(told)}")
            self._pause(retry_s)

    def _ask(self, key: str, question: dict[str, Any], patience_s: float | None = None) -> tuple[bytes, float]:
        """The answer, and how long it took in s. Waits until there is one."""
        begun_s = time.monotonic()
        patience_s = self.patience_s if patience_s is None else patience_s
        check = partial(self._check_going, begun_s, patience_s)
        found = until_answered(self._transport, key, question, check, self._silent, self._pause)
        self._answered_s, self.waiting = time.monotonic(), None
        return found

    def _silent(self) -> None:
        self.waiting = f"for somebody to serve map '{self.name}'"
        self._parts.lost()

    def _pause(self, seconds: float) -> None:
        if self._stop.wait(seconds):
            raise StoppedFetchError("the fetch was stopped")

    def _check_going(self, begun_s: float, patience_s: float) -> None:
        if self._stop.is_set():
            raise StoppedFetchError("the fetch was stopped")
        if time.monotonic() - max(begun_s, self._answered_s) > patience_s:
            raise SourceError(
                f"nobody answered about map '{self.name}' for {patience_s:g} s: is it served under this name, and "
                "is the network connected?"
            )


def maps_on(transport: Transport, timeout_s: float = ANSWER_S) -> list[dict[str, Any]]:
    """The maps that are served on a network, as their servers describe them; answers that make no sense are left out.

    Raises TransportError.
    """
    found: dict[str, dict[str, Any]] = {}
    for answer in transport.ask_all(KEY, b"", timeout_s):
        try:
            told = read_object(answer, MAX_EVENT_BYTES).get("maps")
        except JsonRefusedError as error:
            logger.warning("the server refuses to list its maps: %s", error)
            continue
        for one in told if isinstance(told, list) else ():
            about = _summary(one)
            if about is not None and len(found) < MAX_MAPS:
                found.setdefault(about["name"], about)
    return [one for _, one in sorted(found.items())]


def _object(answer: bytes) -> dict[str, Any]:
    try:
        return read_object(answer, MAX_EVENT_BYTES)
    except JsonRefusedError as error:
        raise SourceError(f"the answer about a map cannot be read: {error}") from None


def _summary(told: Any) -> dict[str, Any] | None:
    """The fields of a map in a list of maps, without others; None if they make no sense."""
    if not isinstance(told, dict) or not isinstance(told.get("name"), str) or not is_name(told["name"]):
        return None
    found = {field: told[field] for field in SUMMARY if field in told}
    for value in found.values():
        for one in value[:MOST_NUMBERS] if isinstance(value, list) else (value,):
            if not isinstance(one, int | float | None) and (not isinstance(one, str) or len(one) > MOST_TEXT):
                return None
        if isinstance(value, list) and len(value) > MOST_NUMBERS:
            return None
    return found


def _tiles_of(page: dict[str, Any]) -> int:
    """The number of tiles that a page says the map has, within what is allowed."""
    tiles = page.get("tiles")
    return min(tiles, MAX_TILES) if isinstance(tiles, int) else 0


def _counted(page: dict[str, Any]) -> int:
    places = page.get("places")
    return len(places) if isinstance(places, list) else 0
