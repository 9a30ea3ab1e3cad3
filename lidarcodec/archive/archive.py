"""Archive: reads frames straight from a store. The public door is `lidarcodec.open_archive`.

A frame takes three requests: a listing of commits near its time, its commit, and the bytes from its key message on.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from itertools import groupby
from pathlib import Path
from typing import Any, Final, NamedTuple

from lidarcodec.archive.contents import commits_of
from lidarcodec.archive.index import tables_to_read
from lidarcodec.archive.names import Commit
from lidarcodec.archive.objects import Place, places_of, read_commit
from lidarcodec.archive.stores.base import Store
from lidarcodec.archive.stores.table import open_store
from lidarcodec.errors import ChecksumError, SettingsError, SourceError
from lidarcodec.frame import Frame
from lidarcodec.pipeline import StreamDecoder
from lidarcodec.untrusted.times import time_ns_of
from lidarcodec.wire import unpack

log = logging.getLogger(__name__)

READ_AHEAD: Final = 64 << 10
"""Gaps of at most so many bytes are read too, which is quicker than another request."""
MAX_READ: Final = 64 << 20
"""Most bytes of a request, so that memory stays bounded."""

Time = str | int | datetime


class Coded(NamedTuple):
    """A coded message from the archive. wanted: whether its frames were asked for; a key message and others may only
    be needed to decode these"""

    commit: Commit
    place: Place
    data: bytes
    wanted: bool


class Archive:
    """An archive for reading. store: where it is"""

    def __init__(self, where: str | Path | Store) -> None:
        """Raises UnknownNameError, MissingExtraError or SourceError if there can be no archive."""
        self.store = open_store(where)

    def frames(
        self,
        *,
        vehicle: str | None = None,
        sensor: str | None = None,
        between: tuple[Time, Time] | None = None,
        where: str | None = None,
    ) -> Iterator[Frame]:
        """Decoded frames in order of vehicle, sensor and time.

        between: first and last time: ISO 8601 (UTC without a zone), datetime, or ns since the Unix epoch
        where: a condition of SQL on the table of frames instead, as for `archive query`
        Raises SettingsError for a time or condition that is wrong, DecodeError for damaged data, SourceError for a
        damaged archive or one whose segments are replaced all the time, OSError.
        """
        return (frame for _, frame in self.decoded(vehicle=vehicle, sensor=sensor, between=between, where=where))

    def decoded(self, **which: Any) -> Iterator[tuple[Commit, Frame]]:
        """As `frames`, each with its segment."""
        limits = span_of(which.get("between"))
        for commit, messages in groupby(self.messages(**which), key=lambda one: one.commit):
            decoder = StreamDecoder()
            for one in messages:
                frames = decoder.decode(unpack(one.data))
                yield from ((commit, frame) for frame in frames if one.wanted and _inside(frame, limits))
            yield from ((commit, frame) for frame in decoder.flush() if _inside(frame, limits))

    def messages(
        self,
        *,
        vehicle: str | None = None,
        sensor: str | None = None,
        between: tuple[Time, Time] | None = None,
        where: str | None = None,
    ) -> Iterator[Coded]:
        """Coded messages that hold the frames, and those that decoding them needs. Arguments as of `frames`."""
        limits = span_of(between)
        if where is not None:
            if vehicle or sensor or between:
                raise SettingsError("give either a condition, or vehicle, sensor and times", "where")
            yield from self._where(where)
            return
        for commit in commits_of(self.store, vehicle, sensor, limits):
            places = places_of(value := read_commit(self.store, commit))
            yield from self._read(commit, value["object"], places, _by_time(places, limits))

    def query(self, sql: str) -> tuple[list[str], list[tuple[Any, ...]]]:
        """Names of columns and rows of a query in SQL over the table `frames`. Raises SettingsError, OSError."""
        from lidarcodec.archive.query import query

        return query(self.store, sql)[:2]

    def _where(self, condition: str) -> Iterator[Coded]:
        from lidarcodec.archive.query import TRIES, segments_where

        for _ in range(TRIES):
            wanted, commits = segments_where(self.store, condition), commits_of(self.store)
            if wanted.keys() <= {commit.segment for commit in commits}:
                break  # otherwise some were replaced in between
        else:
            raise SourceError(f"{self.store.url}: segments are being replaced all the time: try again later")
        for commit in commits:
            offsets = wanted.get(commit.segment)
            if offsets is not None:
                places = places_of(value := read_commit(self.store, commit))
                yield from self._read(commit, value["object"], places, _at(offsets))

    def _read(
        self, commit: Commit, name: str, places: Sequence[Place], wanted: Callable[[Place], bool]
    ) -> Iterator[Coded]:
        """The wanted messages of a recording and those before them since a key message, read in few requests."""
        needed = _needed(places, wanted)
        for first, last in _joined([place for place, _ in needed]):
            inside = [(place, is_wanted) for place, is_wanted in needed if first <= place.offset < last]
            data = self.store.read(name, first, last - first)
            for place, is_wanted in inside:
                message = data[place.offset - first : place.offset - first + place.length]
                if len(message) != place.length:
                    raise ChecksumError(f"{name} ends before byte {place.offset + place.length}", place.offset)
                yield Coded(commit, place, message, is_wanted)

    def tables(self) -> list[str]:
        """Names of the Parquet files with the rows of all frames."""
        return tables_to_read(self.store).names


def open_archive(where: str | Path) -> Archive:
    """An archive in a folder, or at `s3://BUCKET/PREFIX`, `gs://...` or `az://...`, to read frames from.

    Raises UnknownNameError for another address, MissingExtraError without the extra `archive`, SourceError.
    """
    return Archive(where)


def time_ns(time: Time) -> int:
    """A time in ns since the Unix epoch. Raises SettingsError.

    >>> time_ns("2026-11-26T12:00:00.000000007Z"), time_ns("2026-11-26 12:00:00.5"), time_ns("5")
    (1795694400000000007, 1795694400500000000, 5)
    """
    if isinstance(time, int):
        return time
    if isinstance(time, str):
        with suppress(SettingsError):  # else a date, or a time without a zone
            return time_ns_of(time)
    try:
        moment = datetime.fromisoformat(time) if isinstance(time, str) else time
    except ValueError:
        raise SettingsError(f"'{time}' is no time: write it as 2026-11-26T12:00:00Z", "between") from None
    whole = moment if moment.tzinfo else moment.replace(tzinfo=UTC)
    since = whole - datetime(1970, 1, 1, tzinfo=UTC)
    return (since.days * 86400 + since.seconds) * 10**9 + since.microseconds * 1000


def span_of(between: tuple[Time, Time] | None) -> tuple[int, int] | None:
    """First and last time in ns. Raises SettingsError."""
    if between is None:
        return None
    first, last = map(time_ns, between)
    if first > last:
        raise SettingsError("the first time is later than the last one", "between")
    return first, last


def _inside(frame: Frame, limits: tuple[int, int] | None) -> bool:
    return limits is None or limits[0] <= frame.stamp_ns <= limits[1]


def _at(offsets: set[int]) -> Callable[[Place], bool]:
    return lambda place: place.offset in offsets


def _by_time(places: Sequence[Place], limits: tuple[int, int] | None) -> Callable[[Place], bool]:
    """Whether a message may hold frames of a time. A message of several frames reaches to the next one."""
    if limits is None:
        return lambda _: True
    ends = {
        place.offset: place.stamp_ns if place.frames == 1 else max(place.stamp_ns, following.stamp_ns)
        for place, following in zip(places, [*places[1:], places[-1]._replace(stamp_ns=1 << 62)], strict=True)
    }
    return lambda place: place.stamp_ns <= limits[1] and ends[place.offset] >= limits[0]


def _needed(places: Sequence[Place], wanted: Callable[[Place], bool]) -> list[tuple[Place, bool]]:
    """Messages to read, each with whether it is wanted itself. A message needs the key message before it, and those
    that it refers to, directly or not."""
    numbers = {place.frame + more: at for at, place in enumerate(places) for more in range(place.frames)}
    keys: list[int] = []
    for at, place in enumerate(places):
        keys.append(at if place.key or not keys else keys[-1])
    chosen = {at: True for at, place in enumerate(places) if wanted(place)}
    waiting = list(chosen)
    while waiting:
        at = waiting.pop()
        for other in (keys[at], numbers.get(places[at].needs, at)):
            if other not in chosen:
                chosen[other] = False
                waiting.append(other)
    return [(places[at], chosen[at]) for at in sorted(chosen)]


def _joined(places: Sequence[Place]) -> Iterator[tuple[int, int]]:
    """Ranges of bytes (first, end) that cover messages in order, with small gaps between them included."""
    first = last = -1
    for place in places:
        end = place.offset + place.length
        if first >= 0 and 0 <= place.offset - last <= READ_AHEAD and end - first <= MAX_READ:
            last = end
            continue
        if first >= 0:
            yield first, last
        first, last = place.offset, end
    if first >= 0:
        yield first, last
