"""LiveHub: the streams that are viewed. Each has one receiver for all viewers, and none without a viewer."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from collections import Counter
from collections.abc import AsyncIterator, Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Final

from lidarcodec.apps.picture import perspective_of, png_of, range_strip_of
from lidarcodec.apps.timings import Timings
from lidarcodec.errors import TransportError
from lidarcodec.filling import filled
from lidarcodec.frame import Frame
from lidarcodec.transport import Transport
from lidarcodec.transport.keys import StreamKeys
from lidarcodec_server.live.options import View
from lidarcodec_server.live.seats import Seat, Seats, TooManyViewersError
from lidarcodec_server.live.viewer import Viewer
from lidarcodec_server.live.watch import TICK_S, Watch

logger = logging.getLogger(__name__)

LINGER_S: Final = 2.0
"""How long a receiver stays after its last viewer left, so that a reloaded page finds it running."""
ACK_LIMIT_S: Final = 15.0
OPEN_S: Final = 20.0
CLOSE_S: Final = 15.0
"""Time limits to open a stream, and to close all of them when the server stops."""
PICTURE_AGE_S: Final = 1.0
MEND_S: Final = 1.0
PICTURE_WAIT_S: Final = 2.5
THREADS: Final = 2
"""Threads that prepare frames and open and close receivers; pictures have a thread of their own."""


class _Place:
    """A stream's watch, the number of its users, and a lock for opening and closing it."""

    def __init__(self) -> None:
        self.lock = asyncio.Lock()
        self.watch: Watch | None = None
        self.users = 0
        self.left_at = 0.0
        self.ticker: asyncio.Task[None] | None = None
        self.closer: asyncio.Task[None] | None = None


class LiveHub:
    """Belongs to the event loop in which it is made.

    transport: gives the open network session, which the caller closes; raises TransportError while there is none
    seats: the live sockets of clients
    linger_s: how long a receiver stays after its last viewer left
    ack_limit_s: longest time for a viewer to acknowledge a frame
    counts: `viewers`, `refused`, `slow` (closed because they acknowledged nothing), `abuse`;  and `sent`, `skipped` and
    `sent_bytes` of viewers that have left, by kind;  pack_ms: time to prepare a frame, once for all viewers
    """

    def __init__(
        self, transport: Callable[[], Transport], *, seats: Seats | None = None, ack_limit_s: float = ACK_LIMIT_S
    ) -> None:
        self.seats = Seats() if seats is None else seats
        self.linger_s, self.ack_limit_s = LINGER_S, ack_limit_s
        self.counts: Counter[str] = Counter()
        self.pack_ms = Timings()
        self._transport = transport
        self._loop = asyncio.get_running_loop()
        self._places: dict[StreamKeys, _Place] = {}
        self._closed = False
        self._workers = ThreadPoolExecutor(THREADS, "lidarcodec live")
        self._painter = ThreadPoolExecutor(1, "lidarcodec picture")
        self._openers = ThreadPoolExecutor(2 * THREADS, "lidarcodec open")

    @contextlib.asynccontextmanager
    async def watching(self, keys: StreamKeys, *, decode: bool) -> AsyncIterator[Watch]:
        """The watch of a stream; it is opened if needed. Raises TransportError."""
        place = self._places.setdefault(keys, _Place())
        place.users += 1
        try:
            try:
                async with asyncio.timeout(OPEN_S), place.lock:
                    if self._closed:
                        raise TransportError("the server is shutting down")
                    watch = place.watch or await self._open(keys, place)
            except TimeoutError:
                raise TransportError(
                    f"{keys.vehicle}/{keys.sensor} could not be opened within {OPEN_S:g} s: try again"
                ) from None
            watch.decode(+1 if decode else 0)
            try:
                yield watch
            finally:
                watch.decode(-1 if decode else 0)
        finally:
            place.users -= 1
            place.left_at = self._loop.time()
            if place.closer is None or place.closer.done():
                place.closer = self._loop.create_task(self._close_later(keys, place))

    @contextlib.asynccontextmanager
    async def viewing(self, keys: StreamKeys, viewer: Viewer, seat: Seat) -> AsyncIterator[Watch]:
        """The same for a viewer; the viewer gets the frames meanwhile. seat: its place, which it may lose to another
        client

        Raises TooManyViewersError, TransportError.
        """
        seat.end = viewer.give_way
        try:
            self.seats.take(seat)
        except TooManyViewersError:
            self.counts["refused"] += 1
            raise
        self.counts["viewers"] += 1
        try:
            async with self.watching(keys, decode=viewer.decodes) as watch:
                watch.add(viewer)
                seat.silent_s = watch.silent_s
                try:
                    yield watch
                finally:
                    watch.remove(viewer)
        finally:
            self.seats.leave(seat)
            for name in ("sent", "skipped", "sent_bytes"):
                self.counts[f"{viewer.kind} {name}"] += getattr(viewer, name)

    def work(self, make: Callable[[], bytes]) -> asyncio.Future[bytes]:
        """Run a function in a thread, and measure its time."""

        def timed() -> bytes:
            start = time.perf_counter()
            made = make()
            self.pack_ms.add(1e3 * (time.perf_counter() - start))
            return made

        return self._loop.run_in_executor(self._workers, timed)

    async def snapshot(self, keys: StreamKeys, view: View, *, fill: bool = True) -> bytes | None:
        """The newest frame as PNG; None if no frame arrives in time. Each frame is drawn once.

        fill: whether to interpolate returns between columns that were sent

        Raises TransportError.
        """
        async with self.watching(keys, decode=True) as watch:
            found = await watch.newest(PICTURE_AGE_S, PICTURE_WAIT_S)
        if found is None:
            return None
        return await found.made((view, fill), lambda: _picture(found.frame, view, fill), self._paint)

    def watches(self) -> dict[StreamKeys, Watch]:
        """Streams that are watched now."""
        return {keys: place.watch for keys, place in self._places.items() if place.watch is not None}

    def state(self) -> dict[str, Any]:
        """Counts, and the state of each stream that is watched."""
        streams = {f"{keys.vehicle}/{keys.sensor}": watch.state() for keys, watch in self.watches().items()}
        return {"viewers": len(self.seats), "counts": dict(self.counts), "streams": streams}

    async def close(self) -> None:
        """End everything, within the time limits of the receivers."""
        self._closed = True  # from now on `watching` raises TransportError
        closing = [self._loop.create_task(self._close(keys, place)) for keys, place in list(self._places.items())]
        if closing:
            _, late = await asyncio.wait(closing, timeout=CLOSE_S)
            if late:
                logger.warning("%d streams could not be closed within %g s", len(late), CLOSE_S)
        for pool in (self._workers, self._painter, self._openers):
            pool.shutdown(wait=False, cancel_futures=True)

    async def _open(self, keys: StreamKeys, place: _Place) -> Watch:
        watch = Watch(keys, self._transport(), self._loop)
        try:
            await self._loop.run_in_executor(self._openers, watch.start)
        except BaseException:  # no caller waits for it any more
            self._loop.run_in_executor(self._openers, watch.close)
            raise
        logger.info("%s is watched", keys.prefix)
        place.watch, place.ticker = watch, self._loop.create_task(self._tick(watch))
        return watch

    async def _close_later(self, keys: StreamKeys, place: _Place) -> None:
        """Stop decoding, or close the stream, when it had no viewer for a while."""
        while (pause_s := place.left_at + self.linger_s - self._loop.time()) > 0:
            await asyncio.sleep(pause_s)
        if place.watch is not None:
            place.watch.rest()
        await self._close(keys, place)

    async def _close(self, keys: StreamKeys, place: _Place) -> None:
        async with place.lock:
            if place.users and not self._closed:
                return
            watch, place.watch = place.watch, None
            if watch is not None:
                if place.ticker is not None:
                    place.ticker.cancel()
                await self._loop.run_in_executor(self._openers, watch.close)
                logger.info("%s is not watched any more", keys.prefix)
            if not place.users and self._places.get(keys) is place:
                del self._places[keys]

    async def _tick(self, watch: Watch) -> None:
        failure: object = None
        while True:
            await asyncio.sleep(TICK_S)
            watch.tick()
            failure = watch.receiver.failure or failure
            if failure is not None:
                failure = await self._mend(watch, failure)

    async def _mend(self, watch: Watch, failure: object) -> Exception | None:
        """Replace a receiver that failed; the viewers stay. Returns what fails again."""
        self.counts["receivers failed"] += 1
        logger.warning("%s: receiving was interrupted and starts again: %s", watch.keys.prefix, failure)
        await self._loop.run_in_executor(self._openers, watch.close)
        await asyncio.sleep(MEND_S)
        try:
            watch.renew(self._transport())
            await self._loop.run_in_executor(self._openers, watch.start)
        except Exception as error:  # for any error: the next check tries again
            logger.debug("%s: receiving still fails: %s", watch.keys.prefix, error)
            return error
        return None

    def _paint(self, make: Callable[[], bytes]) -> asyncio.Future[bytes]:
        return self._loop.run_in_executor(self._painter, make)


def _picture(frame: Frame, view: View, fill: bool) -> bytes:
    draw = perspective_of if view == "cloud" else range_strip_of
    return png_of(draw(filled(frame) if fill else frame))
