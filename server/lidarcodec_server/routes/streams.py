"""`/api/v1/streams`: which streams there are, and what each of them does."""

from __future__ import annotations

from fastapi import APIRouter

from lidarcodec.transport.keys import StreamKeys
from lidarcodec_server.auth import Viewer
from lidarcodec_server.fleet import Stream
from lidarcodec_server.problems import ProblemError
from lidarcodec_server.routes.common import TheService, TheStream
from lidarcodec_server.schemas import StreamAnswer
from lidarcodec_server.service import Service

router = APIRouter(prefix="/api/v1/streams", tags=["streams"])


@router.get("")
def streams(service: TheService, client: Viewer) -> list[StreamAnswer]:
    """All streams that were seen, or that settings are kept for, by name."""
    return [StreamAnswer.of(stream) for stream in service.streams()]


@router.get("/{vehicle}/{sensor}")
def stream(service: TheService, keys: TheStream, client: Viewer) -> StreamAnswer:
    """One stream."""
    return StreamAnswer.of(known_stream(service, keys))


def known_stream(service: Service, keys: StreamKeys) -> Stream:
    """What is known of a stream.

    Raises ProblemError 404 when it was never seen.
    """
    found = service.stream(keys)
    if found is None:
        raise ProblemError(404, f"no stream {keys.vehicle}/{keys.sensor} was ever seen here", "unknown-stream")
    return found
