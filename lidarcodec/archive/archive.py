"""Archive: reads frames straight from a store. The public door is `lidarcodec.open_archive`.

A frame takes three requests: a listing of commits near its time, its commit, and the bytes from its key message on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from datetime import UTC, datetime
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lidarcodec.archive.contents import commits_of
from lidarcodec.archive.index import tables_to_read
from lidarcodec.archive.messages import Chosen, Coded, decoded_frames, messages_of
from lidarcodec.archive.names import Commit
from lidarcodec.archive.stores.base import Store
from lidarcodec.archive.stores.table import check_there, open_store
from lidarcodec.errors import MissingExtraError, SettingsError, SourceError
from lidarcodec.frame import Frame
from lidarcodec.untrusted.times import time_ns_of

if TYPE_CHECKING:
    from lidarcodec.archive.dataset import FrameDataset

Time = str | int | datetime


class Archive:
    """An archive for reading.

    store: where it is;  lost: segments whose tables are lost, which the last condition could not see
    """

    def __init__(self, where: str | Path | Store) -> None:
        """Raises UnknownNameError, MissingExtraError or SourceError if there can be no archive."""
        self.store = open_store(where)
        self.lost = 0

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
            yield from ((commit, frame) for frame in decoded_frames(messages, limits))

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
        for chosen in self.segments(vehicle=vehicle, sensor=sensor, between=between, where=where):
            yield from messages_of(self.store, chosen, limits)

    def segments(
        self,
        *,
        vehicle: str | None = None,
        sensor: str | None = None,
        between: tuple[Time, Time] | None = None,
        where: str | None = None,
    ) -> list[Chosen]:
        """Segments that hold the frames, in order of vehicle, sensor and time. Arguments as of `frames`."""
        if where is None:
            return [Chosen(one, None) for one in commits_of(self.store, vehicle, sensor, span_of(between))]
        if vehicle or sensor or between:
            raise SettingsError("give either a condition, or vehicle, sensor and times", "where")
        return self._where(where)

    def dataset(
        self,
        *,
        vehicle: str | None = None,
        sensor: str | None = None,
        between: tuple[Time, Time] | None = None,
        where: str | None = None,
        transform: Callable[[Frame], Any] | None = None,
        shuffle: bool = True,
        seed: int = 0,
        buffer: int = 128,
        rank: int | None = None,
        world: int | None = None,
    ) -> FrameDataset:
        """The frames as an IterableDataset of torch, shared out over the workers of a DataLoader and over ranks.

        transform: makes an example of a frame, in the worker; by default examples are frames
        shuffle: whether order changes with `seed` and epoch;  buffer: frames that a worker mixes
        rank, world: number of this process, and how many there are; by default those of torch.distributed
        Other arguments as of `frames`.
        Raises MissingExtraError without torch, SettingsError, SourceError if there is no such segment, OSError.
        """
        try:
            from lidarcodec.archive.dataset import FrameDataset
        except ModuleNotFoundError as error:
            if error.name is None or error.name.partition(".")[0] != "torch":
                raise
            raise MissingExtraError("a dataset for training", "torch") from None
        segments = self.segments(vehicle=vehicle, sensor=sensor, between=between, where=where)
        return FrameDataset(self.store, segments, span_of(between), transform, shuffle, seed, buffer, rank, world)

    def query(self, sql: str) -> tuple[list[str], list[tuple[Any, ...]]]:
        """Names of columns and rows of a query in SQL over the table `frames`. Raises SettingsError, OSError."""
        from lidarcodec.archive.query import query

        return query(self.store, sql)[:2]

    def _where(self, condition: str) -> list[Chosen]:
        from lidarcodec.archive.query import TRIES, segments_where

        for _ in range(TRIES):
            (wanted, self.lost), commits = segments_where(self.store, condition), commits_of(self.store)
            if wanted.keys() <= {commit.segment for commit in commits}:
                return [Chosen(one, frozenset(wanted[one.segment])) for one in commits if one.segment in wanted]
        raise SourceError(f"{self.store.url}: segments are being replaced at the moment: try again later")

    def tables(self) -> list[str]:
        """Names of the Parquet files with the rows of all frames."""
        return tables_to_read(self.store).names


def open_archive(where: str | Path) -> Archive:
    """An archive in a folder, or at `s3://BUCKET/PREFIX`, `gs://...` or `az://...`, to read frames from.

    Raises UnknownNameError for another address, MissingExtraError without the extra `archive`, SourceError, also for a
    folder that does not exist.
    """
    return Archive(check_there(open_store(where)))


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
        raise SettingsError(f"'{time}' is not a time: write it as 2026-11-26T12:00:00Z", "between") from None
    whole = moment if moment.tzinfo else moment.replace(tzinfo=UTC)
    since = whole - datetime(1970, 1, 1, tzinfo=UTC)
    return (since.days * 86400 + since.seconds) * 10**9 + since.microseconds * 1000


def span_of(between: tuple[Time, Time] | None) -> tuple[int, int] | None:
    """First and last time in ns. Raises SettingsError."""
    if between is None:
        return None
    first, last = map(time_ns, between)
    if first > last:
        raise SettingsError("'from' is later than 'to'", "between")
    return first, last
