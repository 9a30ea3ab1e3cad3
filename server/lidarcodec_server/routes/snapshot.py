"""`GET .../snapshot.png`: a picture of a stream's newest frame."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Response

from lidarcodec_server.auth import Viewer
from lidarcodec_server.live.options import View
from lidarcodec_server.problems import ProblemError
from lidarcodec_server.routes.live import Fills, Hub, Known

router = APIRouter(prefix="/api/v1/streams", tags=["live"])


@router.get(
    "/{vehicle}/{sensor}/snapshot.png",
    response_class=Response,
    responses={
        200: {"content": {"image/png": {}}, "description": "The picture."},
        404: {"description": "No such stream."},
        503: {"description": "The vehicle is away, or the server has no network session."},
        504: {"description": "The vehicle is online, but no frame arrived in time."},
    },
)
async def snapshot(
    client: Viewer,
    known: Known,
    hub: Hub,
    fills: Fills,
    view: Annotated[View, Query(description="`cloud`: the points in perspective. `range`: the range image.")] = "cloud",
) -> Response:
    """The newest frame as PNG, at most a second old without other viewers."""
    keys = known.keys
    if not known.alive:
        raise ProblemError(503, f"{keys.vehicle}/{keys.sensor} is not connected", "vehicle-away", {"Retry-After": "5"})
    picture = await hub.snapshot(keys, view, fill=fills)
    if picture is None:
        raise ProblemError(504, f"no frame of {keys.vehicle}/{keys.sensor} arrived in time", "no-frame")
    return Response(picture, media_type="image/png", headers={"Cache-Control": "no-store"})
