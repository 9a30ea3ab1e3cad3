"""Maps: which there are, their tiles, and the points of tiles for the page."""

from __future__ import annotations

import gzip
from typing import Annotated, Any, Final, Literal

import anyio
from fastapi import APIRouter, Path, Query, Response
from pydantic import BaseModel, Field
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request

from lidarcodec.errors import SourceError
from lidarcodec.maps.served.manifest import PAGE
from lidarcodec.maps.served.shelf import ShelvedMap
from lidarcodec.maps.tiles import MOST_PLACE
from lidarcodec.settings import MAX_NAME, NAME_PATTERN
from lidarcodec_server.auth import Viewer
from lidarcodec_server.live.download import MEDIA_TYPE
from lidarcodec_server.problems import ProblemError
from lidarcodec_server.routes.common import TheService
from lidarcodec_server.service import Service

router = APIRouter(prefix="/api/v1", tags=["maps"])

DECODED_AT_ONCE: Final = 2
Name = Annotated[str, Path(pattern=f"^{NAME_PATTERN.pattern}$", max_length=MAX_NAME, examples=["town"])]
Place = Annotated[int, Path(ge=-MOST_PLACE, le=MOST_PLACE, examples=[3])]
Position = Annotated[float | None, Query(ge=-1e8, le=1e8, allow_inf_nan=False)]
NO_SUCH: dict[int | str, dict[str, Any]] = {
    304: {"description": "It is what `If-None-Match` says."},
    404: {"description": "No such map, or no such tile."},
    507: {"description": "The file of the map cannot be read."},
}
BYTES: dict[int | str, dict[str, Any]] = {
    200: {"description": "The tile.", "content": {MEDIA_TYPE: {"schema": {"type": "string", "format": "binary"}}}}
}


class MapAnswer(BaseModel):
    """A map. Lengths are in metres."""

    name: str
    version: str = Field(description="SHA-256 of its file.")
    points: int
    bytes: int = Field(description="Of all tiles and the path.")
    tiles: int
    tile_m: int = Field(description="Width of a tile.")
    step_m: float = Field(description="Step of coordinates.")
    length_m: float = Field(description="Length of the drives that it was built from.")
    frame: str = Field(description="`local`, or the zone of UTM.")
    origin: list[float] | None = Field(description="Latitude, longitude and heading of the origin, in UTM.")
    bounds_m: list[float] | None = Field(description="Smallest x and y, and largest x and y, of its tiles.")


class TileAnswer(BaseModel):
    """A tile of a map. x, y: its place, in widths of a tile"""

    x: int
    y: int
    bytes: int
    hash: str = Field(description="SHA-256 of its bytes, and its ETag.")


class ManifestAnswer(MapAnswer):
    """A map with its tiles, and where the next ones begin."""

    places: list[TileAnswer]
    next: int | None = Field(description="Value of `from` for the next tiles; null if these are the last.")


@router.get("/maps")
def all_maps(service: TheService, client: Viewer) -> list[MapAnswer]:
    """All maps, by name."""
    return [MapAnswer(**one.manifest.summary()) for one in service.maps.all()]


@router.get("/maps/{name}", response_model=ManifestAnswer, responses=NO_SUCH)
def one_map(
    service: TheService,
    request: Request,
    client: Viewer,
    name: Name,
    first: Annotated[int, Query(alias="from", ge=0, le=2**31)] = 0,
    x: Position = None,
    y: Position = None,
    radius: Annotated[float, Query(ge=0.0, le=1e7, allow_inf_nan=False)] = 200.0,
) -> Response:
    """A map and its tiles, at most 4,000 at once. With `x` and `y` only tiles within a `radius` of that place."""
    manifest = _found(service, name).manifest
    headers = _headers(manifest.version)
    if _is_had(request, manifest.version):
        return Response(status_code=304, headers=headers)
    if (x is None) != (y is None):
        raise ProblemError(422, "give both x and y, or neither", "request", field="y" if y is None else "x")
    tiles = manifest.tiles
    if x is not None and y is not None:
        tiles = tuple(tile for _, tile in manifest.near(x, y, radius))
    shown = tiles[first : first + PAGE]
    places = [
        TileAnswer(x=tile.place[0], y=tile.place[1], bytes=tile.size, hash=tile.hash) for tile in shown if tile.place
    ]
    following = first + PAGE if first + PAGE < len(tiles) else None
    answer = ManifestAnswer(**manifest.summary(), places=places, next=following)
    return Response(answer.model_dump_json(), headers=headers, media_type="application/json")


@router.get("/maps/{name}/{x}/{y}", response_class=Response, responses={**BYTES, **NO_SUCH})
async def tile(
    service: TheService,
    request: Request,
    client: Viewer,
    name: Name,
    x: Place,
    y: Place,
    form: Annotated[
        Literal["tile", "points"],
        Query(
            description="`tile`: the bytes of the tile. `points`: its points as 32-bit floats x, y, z, little "
            "endian, in metres, x and y from the corner of the tile; at most 100,000."
        ),
    ] = "tile",
) -> Response:
    """A tile, with its SHA-256 as ETag."""
    shelved = _found(service, name)
    piece = shelved.pieces.get((x, y))
    if piece is None:
        raise ProblemError(404, f"map '{name}' has no tile {x}/{y}: GET /api/v1/maps/{name} lists all", "unknown-tile")
    tag = piece.hash if form == "tile" else f"{piece.hash}-points"
    headers = _headers(tag)
    if _is_had(request, tag):
        return Response(status_code=304, headers=headers)
    try:
        if form == "tile":
            return Response(await run_in_threadpool(shelved.read, piece), headers=headers, media_type=MEDIA_TYPE)
        limiter = _limiter(request)
        body = await anyio.to_thread.run_sync(service.map_points.packed, shelved, piece, limiter=limiter)
    except SourceError as error:
        raise ProblemError(507, str(error), "storage") from None
    if "gzip" in request.headers.get("accept-encoding", "").lower():
        headers["Content-Encoding"] = "gzip"
    else:
        body = await anyio.to_thread.run_sync(gzip.decompress, body, limiter=limiter)
    return Response(body, headers=headers, media_type=MEDIA_TYPE)


def _found(service: Service, name: str) -> ShelvedMap:
    found = service.maps.get(name)
    if found is None:
        raise ProblemError(404, f"there is no map '{name}': GET /api/v1/maps lists all", "unknown-map")
    return found


def _headers(tag: str) -> dict[str, str]:
    return {"ETag": f'"{tag}"', "Cache-Control": "private, no-cache", "Vary": "Accept-Encoding"}


def _is_had(request: Request, tag: str) -> bool:
    """Whether the client has what the tag stands for (RFC 9110, If-None-Match)."""
    had = [one.strip().removeprefix("W/") for one in request.headers.get("if-none-match", "").split(",")]
    return "*" in had or f'"{tag}"' in had


def _limiter(request: Request) -> anyio.CapacityLimiter:
    """Places for decoding: few, so that other requests always find a thread."""
    state = request.app.state
    if not hasattr(state, "decoding"):
        state.decoding = anyio.CapacityLimiter(DECODED_AT_ONCE)
    limiter: anyio.CapacityLimiter = state.decoding
    return limiter
