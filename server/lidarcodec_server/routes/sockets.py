"""`WS .../cloud` and `WS .../frames`: a live stream, decoded or as the vehicle sent it (docs/live-sockets.md)."""

from __future__ import annotations

from fastapi import APIRouter, WebSocket

from lidarcodec.transport.keys import StreamKeys
from lidarcodec_server.auth import Viewer, host, require_viewer, subprotocol_of
from lidarcodec_server.live import session
from lidarcodec_server.live.hub import LiveHub
from lidarcodec_server.live.options import CloudOptions, FramesOptions
from lidarcodec_server.live.seats import Seat, TooManyViewersError
from lidarcodec_server.live.viewer import CloudViewer, FramesViewer
from lidarcodec_server.problems import ProblemError
from lidarcodec_server.routes.live import Fills, Hub, Known
from lidarcodec_server.tokens import Client

router = APIRouter(prefix="/api/v1/streams", tags=["live"])


@router.websocket("/{vehicle}/{sensor}/cloud")
async def cloud(websocket: WebSocket, client: Viewer, known: Known, hub: Hub, fills: Fills) -> None:
    """Send decoded frames, only the newest."""
    await _serve(websocket, client, hub, known.keys, CloudViewer(CloudOptions.of(websocket.query_params, fills)))


@router.websocket("/{vehicle}/{sensor}/frames")
async def frames(websocket: WebSocket, client: Viewer, known: Known, hub: Hub) -> None:
    """Send messages as the vehicle sent them, the newest ones that this viewer can decode."""
    await _serve(websocket, client, hub, known.keys, FramesViewer(FramesOptions.of(websocket.query_params)))


async def _serve(
    websocket: WebSocket, client: Client, hub: LiveHub, keys: StreamKeys, viewer: CloudViewer | FramesViewer
) -> None:
    def allowed() -> bool:
        try:
            require_viewer(websocket)
        except ProblemError:
            return False
        return True

    try:
        protocol = subprotocol_of(websocket)
        seat = Seat(client.name, host(websocket), client.role == "operator")
        await session.run(websocket, hub, keys, viewer, seat, subprotocol=protocol, allowed=allowed)
    except TooManyViewersError as error:
        raise ProblemError(429 if error.own else 503, str(error), "viewers", {"Retry-After": "10"}) from None
