"""Frames of a stream before coding, kept briefly until their decoded frames arrive (docs/live.md)."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import threading
import time
from typing import Final

from lidarcodec.apps.once import Once
from lidarcodec.errors import LidarCodecError
from lidarcodec.frame import Frame
from lidarcodec.pipeline import StreamDecoder
from lidarcodec.transport import Transport
from lidarcodec.transport.base import Inbox
from lidarcodec.transport.keys import StreamKeys
from lidarcodec.wire import unpack
from lidarcodec_server.live.cloud_format import Ranges
from lidarcodec_server.live.ring_geometry import shown_ranges

logger = logging.getLogger(__name__)

KEPT: Final = 16
"""Number of frames that are kept. A decoded frame is one or two frames late, with a group codec up to ten."""
WAIT_S: Final = 1.0
"""How long a decoded frame waits for its original, if the stream has originals. Usually the original is earlier."""
COMING_S: Final = 5.0


class Originals:
    """Receives originals until `close`. All but the thread's part belongs to the event loop."""

    def __init__(self, keys: StreamKeys, transport: Transport, loop: asyncio.AbstractEventLoop) -> None:
        self._keys, self._loop = keys, loop
        self._transport = transport
        self._frames: dict[tuple[int, int], Ranges] = {}
        self._newest = (0, -1)
        self._changed = asyncio.Event()
        self._heard = float("-inf")
        self._inbox: Inbox | None = None
        self._closed = False
        self._once = Once(logger)
        threading.Thread(target=self._run, name="lidarcodec compare", daemon=True).start()

    async def of(self, stream_id: int, index: int) -> Ranges | None:
        """The ranges of a frame before coding. Waits briefly for them, if the stream has originals."""
        end = self._loop.time() + WAIT_S
        while (found := self._frames.get((stream_id, index))) is None:
            left = end - self._loop.time()
            if left <= 0 or self._closed or time.monotonic() - self._heard > COMING_S:
                return None
            if self._newest[0] == stream_id and self._newest[1] > index:  # they arrive in order, so this one never will
                return None
            self._changed.clear()
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._changed.wait(), left)
        return found

    def close(self) -> None:
        """Stop receiving."""
        self._closed = True
        self._changed.set()
        if self._inbox is not None:
            self._inbox.close()

    def _came(self, key: tuple[int, int], ranges: Ranges) -> None:
        self._heard = time.monotonic()
        self._frames[key] = ranges
        self._newest = key
        while len(self._frames) > KEPT:
            self._frames.pop(next(iter(self._frames)))
        self._changed.set()

    # --- in the thread ----------------------------------------------------------------------------------------------

    def _run(self) -> None:
        try:
            self._inbox = inbox = self._transport.inbox(self._keys.original)
            if self._closed:
                inbox.close()
            decoder = StreamDecoder()
            while (data := inbox.receive()) is not None and not self._closed:
                try:
                    message = unpack(data)
                    frames: list[Frame] = decoder.decode(message)
                except LidarCodecError as error:
                    self._once.add("original_errors", error)
                    continue
                for frame in frames:
                    self._loop.call_soon_threadsafe(self._came, (message.stream_id, frame.index), shown_ranges(frame))
        except (LidarCodecError, RuntimeError) as error:  # the network is gone, or the loop is closed
            logger.debug("%s: no more uncompressed frames: %s", self._keys.prefix, error)
