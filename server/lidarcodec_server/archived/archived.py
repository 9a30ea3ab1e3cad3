"""Archived: the archive of a server. Belongs to the event loop; the archive is asked in few threads, with time limits.

A thread that waits for a store that is away stays taken until the store's own limit. Then others are refused.
"""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, TypeVar

from lidarcodec.archive.archive import Archive
from lidarcodec.errors import SourceError
from lidarcodec_server.archived.copies import Copies
from lidarcodec_server.archived.errors import AwayArchiveError, BusyArchiveError, DamagedArchiveError, FullError
from lidarcodec_server.archived.finding import Known, Page, Wanted, find, segment_of
from lidarcodec_server.limits import SparseLog

logger = logging.getLogger(__name__)

QUERIES, COPIES, WAITING, OF_CLIENT = 2, 4, 8, 4
"""Threads for queries and for copies, and most requests for each that run or wait: of all clients, and of one."""
FIND_S: Final = 15.0
COPY_S: Final = 120.0
"""Longest waits of a client for a list, and for a copy of a segment."""
T = TypeVar("T")


class Archived:
    """Segments of an archive: found, and borrowed as files."""

    def __init__(self, archive: Archive, copies: Copies | None = None) -> None:
        self._archive, self._copies = archive, copies or Copies(archive)
        self._warnings = SparseLog(logger)
        self._finders = ThreadPoolExecutor(QUERIES, "lidarcodec archive query")
        self._copiers = ThreadPoolExecutor(COPIES, "lidarcodec archive copy")
        self._looking: Counter[str] = Counter()
        self._copying: Counter[str] = Counter()
        self._ended = False
        self._coming: dict[str, asyncio.Future[None]] = {}

    async def find(self, wanted: Wanted, client: str = "") -> Page:
        """Segments, the newest first. client: its name, for its share of the places

        Raises SettingsError, BusyArchiveError, AwayArchiveError, DamagedArchiveError.
        """
        return await self._look(client, lambda: find(self._archive, wanted, self._warnings.warning))

    async def known(self, segment: str, client: str = "") -> Known:
        """A segment by its commit. Raises NoSegmentError and what `find` raises."""
        end_s = time.monotonic() + FIND_S

        def stopped() -> bool:
            return self._ended or time.monotonic() > end_s

        return await self._look(client, lambda: segment_of(self._archive, segment, stopped))

    async def _look(self, client: str, work: Callable[[], T]) -> T:
        if _is_full(self._looking, client):
            raise BusyArchiveError("too many searches of the archive are running: try again")
        self._looking[client] += 1
        running = asyncio.get_running_loop().run_in_executor(self._finders, work)

        def over(done: asyncio.Future[T]) -> None:
            self._looking -= Counter([client])
            _seen(done)

        running.add_done_callback(over)
        with self._errors():
            return await _in_time(running, FIND_S)

    async def borrow(
        self, segment: str, known: Known | None = None, client: str = ""
    ) -> tuple[Path, Callable[[], object]]:
        """The recording of a segment as a file, and what to call when it is no longer read.

        known: the segment, if it was found already;  client: its name, for its share of the places
        Raises NoSegmentError, FullError, BusyArchiveError, AwayArchiveError, DamagedArchiveError.
        """
        give_back = self._copies.borrow(segment) if segment not in self._coming else None
        if give_back is None:
            await self._copy(segment, known, client)
            give_back = self._copies.borrow(segment)
        if give_back is None:  # others needed its room at once
            raise BusyArchiveError("the server's space for copies of segments is in use: try again")
        return self._copies.path(segment), give_back

    async def _copy(self, segment: str, known: Known | None, client: str) -> None:
        running = self._coming.get(segment)
        if running is None:
            if _is_full(self._copying, client):
                raise BusyArchiveError("too many segments are being fetched from the archive: try again")
            self._copying[client] += 1
            running = asyncio.get_running_loop().run_in_executor(self._copiers, self._make, segment, known)
            self._coming[segment] = running

            def over(done: asyncio.Future[None]) -> None:
                del self._coming[segment]
                self._copying -= Counter([client])
                _seen(done)

            running.add_done_callback(over)
        with self._errors():
            await _in_time(running, COPY_S)

    def _make(self, segment: str, known: Known | None) -> None:
        stop = threading.Event()
        timer = threading.Timer(COPY_S, stop.set)
        timer.daemon = True
        timer.start()
        try:
            self._copies.make(segment, stop, known)
        finally:
            timer.cancel()

    def close(self) -> None:
        """End. Blocks for the disk."""
        self._ended = True
        self._copies.close()
        for pool in (self._finders, self._copiers):
            pool.shutdown(wait=False, cancel_futures=True)

    @contextmanager
    def _errors(self) -> Iterator[None]:
        """Errors of an archive for clients, without its address. The log has that."""
        try:
            yield
        except FullError as error:
            if error.__cause__ is not None:
                self._warnings.warning("a segment of the archive cannot be copied here: %s", error.__cause__)
            raise
        except TimeoutError:
            raise AwayArchiveError("the archive did not answer in time: try again, or ask for less") from None
        except FileNotFoundError as error:
            self._warnings.warning("an object of the archive is missing: %s", error)
            raise DamagedArchiveError("an object of the archive is missing; the server's log has its name") from None
        except OSError as error:
            self._warnings.warning("the archive does not answer: %s", error)
            raise AwayArchiveError("the archive does not answer; the server's log has the reason") from None
        except SourceError as error:
            self._warnings.warning("the archive is damaged: %s", error)
            raise DamagedArchiveError("this part of the archive is damaged; the server's log has the reason") from None


def _is_full(places: Counter[str], client: str) -> bool:
    """Whether all places are taken, or those of a client. A copy goes on though its client has gone."""
    return places.total() >= WAITING or places[client] >= OF_CLIENT


async def _in_time(running: asyncio.Future[T], limit_s: float) -> T:
    """The result, which others may wait for, too. Raises TimeoutError; the work continues."""
    return await asyncio.wait_for(asyncio.shield(running), limit_s)


def _seen(done: asyncio.Future[Any]) -> None:
    """Nobody may be left who waits for it."""
    if not done.cancelled():
        done.exception()
