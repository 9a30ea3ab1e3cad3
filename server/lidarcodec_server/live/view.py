"""FrameView: a decoded frame, encoded for viewers once for each encoding that a viewer wants."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable

from lidarcodec.frame import Frame
from lidarcodec_server.live.cloud_format import Facts, packed, sensor_facts
from lidarcodec_server.live.options import Encoding
from lidarcodec_server.live.originals import Originals

Work = Callable[[Callable[[], bytes]], "asyncio.Future[bytes]"]
"""Runs a function in a thread."""


class FrameView:
    """A frame with its facts; belongs to the event loop."""

    def __init__(self, frame: Frame, facts: Facts, originals: Originals | None = None) -> None:
        """originals: originals of its stream, if a viewer compares"""
        self.frame, self.facts, self._originals = frame, facts, originals
        self._bytes: dict[object, asyncio.Future[bytes]] = {}

    async def encoded(self, encoding: Encoding, work: Work) -> bytes:
        """Its bytes in this encoding."""
        if "original" in encoding.attributes and self._originals is not None:
            original = await self._originals.of(self.facts.stream_id, self.frame.index)
            if original is not None:
                return await self.made(encoding, lambda: packed(self.frame, self.facts, encoding, original), work)
            encoding = encoding._replace(attributes=tuple(one for one in encoding.attributes if one != "original"))
        return await self.made(encoding, lambda: packed(self.frame, self.facts, encoding), work)

    async def sensor(self, work: Work) -> bytes:
        """The facts of its sensor, as JSON."""
        return await self.made("sensor", lambda: json.dumps(sensor_facts(self.frame.sensor, self.frame)).encode(), work)

    async def made(self, what: object, make: Callable[[], bytes], work: Work) -> bytes:
        """Call `make` in a thread, once for all callers with the same `what`; its result."""
        future = self._bytes.get(what)
        if future is None or future.cancelled():
            future = self._bytes[what] = work(make)
        return await asyncio.shield(future)  # if one caller gives up, the others still get it
