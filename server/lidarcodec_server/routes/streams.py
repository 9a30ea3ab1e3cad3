"""`/api/v1/streams`: all streams, with settings and status."""

from __future__ import annotations

from fastapi import APIRouter

from lidarcodec_server.auth import Viewer
from lidarcodec_server.routes.common import TheService, TheStream, known_stream
from lidarcodec_server.schemas import StreamAnswer

router = APIRouter(prefix="/api/v1/streams", tags=["streams"])


@router.get("")
def streams(service: TheService, client: Viewer) -> list[StreamAnswer]:
    """All streams that were seen or have stored settings, sorted by name."""
    return [StreamAnswer.of(stream) for stream in service.streams()]


@router.get("/{vehicle}/{sensor}")
def stream(service: TheService, keys: TheStream, client: Viewer) -> StreamAnswer:
    """One stream."""
    return StreamAnswer.of(known_stream(service, keys))
