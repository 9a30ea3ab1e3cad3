"""One WebSocket of a viewer, from its hello to its end. Access was checked before."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import struct
import time
from collections.abc import Callable
from typing import Any, Final

from starlette.concurrency import run_in_threadpool
from starlette.websockets import WebSocket, WebSocketDisconnect

from lidarcodec.errors import TransportError
from lidarcodec.transport.keys import StreamKeys
from lidarcodec_server.live.cloud_format import FORMAT_VERSION
from lidarcodec_server.live.hub import LiveHub
from lidarcodec_server.live.seats import Seat
from lidarcodec_server.live.viewer import CloudViewer, FramesViewer, Viewer

logger = logging.getLogger(__name__)

MAX_CLIENT_BYTES: Final = 1024
"""Longest message of a viewer, in bytes; it sends only numbers."""
CLOSE_LIMIT_S: Final = 2.0
WATCHDOG_S: Final = 0.25
CHECK_S: Final = 0.3
"""Interval of checks whether a viewer still has permission."""

GOING_AWAY, NOT_UNDERSTOOD, TOO_LONG, FAILED = 1001, 1008, 1009, 1011
NOT_ALLOWED: Final = 4401
NO_ACKNOWLEDGEMENT: Final = 4408
GAVE_WAY: Final = 4429
_INDEX: Final = struct.Struct("<Q")


class _EndError(Exception):
    """Close the socket with this code and reason."""

    def __init__(self, code: int, reason: str, count: str | None = None) -> None:
        super().__init__(reason)
        self.code, self.reason, self.count = code, reason, count


async def run(
    websocket: WebSocket,
    hub: LiveHub,
    keys: StreamKeys,
    viewer: CloudViewer | FramesViewer,
    seat: Seat,
    *,
    subprotocol: str | None = None,
    allowed: Callable[[], bool] = lambda: True,
) -> None:
    """Serve a viewer until it leaves, breaks a rule, or the server stops.

    seat: the viewer's place;  allowed: whether it still has permission; called in a thread, a few times a second
    Raises TooManyViewersError or TransportError before the socket is accepted.
    """
    viewer.tell(_hello(keys, viewer, hub.ack_limit_s))
    async with hub.viewing(keys, viewer, seat):
        await websocket.accept(subprotocol)
        tasks = [
            asyncio.create_task(work)
            for work in (
                _read(websocket, hub, viewer),
                _write(websocket, hub, viewer),
                _watch(viewer, hub.ack_limit_s),
                _check(allowed),
                _give_way(viewer),
            )
        ]
        try:
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            end = next((error for one in done if (error := one.exception()) is not None), None)
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
    await _close(websocket, hub, keys, end)


def _hello(keys: StreamKeys, viewer: CloudViewer | FramesViewer, ack_limit_s: float) -> dict[str, Any]:
    return {
        "event": "hello",
        "format": FORMAT_VERSION,
        "socket": viewer.kind,
        "vehicle": keys.vehicle,
        "sensor": keys.sensor,
        "options": viewer.options.shown(),
        "ack_limit_s": ack_limit_s,
        "server_ns": time.time_ns(),
    }


async def _write(websocket: WebSocket, hub: LiveHub, viewer: Viewer) -> None:
    while True:
        parcel = await viewer.next(hub.work)
        for event in parcel.events:
            await websocket.send_text(event if isinstance(event, str) else json.dumps(event))
        if parcel.frame is not None:
            await websocket.send_bytes(parcel.data)


async def _read(websocket: WebSocket, hub: LiveHub, viewer: Viewer) -> None:
    """Read acknowledgements: the index of a frame, as decimal text or as 8 bytes, or `ack`."""
    while True:
        message = await websocket.receive()
        if message["type"] == "websocket.disconnect":
            hub.counts["abuse"] += "flood" in message  # `ViewerProtocol` has closed and logged it
            return
        data = message.get("bytes")
        text = message.get("text") or ""
        if len(text if data is None else data) > MAX_CLIENT_BYTES:
            raise _EndError(TOO_LONG, f"a client may send at most {MAX_CLIENT_BYTES} bytes", "abuse")
        viewer.acknowledge(_acknowledged(text, data))


def _acknowledged(text: str, data: bytes | None) -> int | None:
    if data is not None and len(data) == _INDEX.size:
        return int(_INDEX.unpack(data)[0])
    if data is None and text == "ack":
        return None
    if data is None and text.isascii() and text.isdigit() and len(text) <= 20:
        return int(text)
    raise _EndError(NOT_UNDERSTOOD, "send the index of a frame, or 'ack'", "abuse")


async def _watch(viewer: Viewer, ack_limit_s: float) -> None:
    while viewer.waited_s <= ack_limit_s:
        await asyncio.sleep(WATCHDOG_S)
    raise _EndError(NO_ACKNOWLEDGEMENT, f"no acknowledgement came within {ack_limit_s:g} s", "slow")


async def _check(allowed: Callable[[], bool]) -> None:
    while await run_in_threadpool(allowed):
        await asyncio.sleep(CHECK_S)
    raise _EndError(NOT_ALLOWED, "the token is no longer valid", "revoked")


async def _give_way(viewer: Viewer) -> None:
    await viewer.must_leave()
    raise _EndError(GAVE_WAY, "all places are taken, and another client has priority", "gave way")


async def _close(websocket: WebSocket, hub: LiveHub, keys: StreamKeys, error: BaseException | None) -> None:
    """Close the socket with its reason, if it is still open."""
    if error is None or isinstance(error, WebSocketDisconnect):
        code, reason = GOING_AWAY, ""
    elif isinstance(error, _EndError):
        code, reason = error.code, error.reason
        hub.counts[error.count or "ended"] += 1
        logger.info("%s: a viewer was disconnected: %s", keys.prefix, reason)
    else:
        code, reason = FAILED, "the server failed; its log has the details"
        hub.counts["failed"] += 1
        logger.error("%s: the socket of a viewer failed", keys.prefix, exc_info=error)
    with contextlib.suppress(RuntimeError, OSError, TimeoutError, WebSocketDisconnect, TransportError):
        await asyncio.wait_for(websocket.close(code, reason), CLOSE_LIMIT_S)  # a client that reads nothing blocks it
