"""Shared by the routes: the service of the app, the stream in a path, and the JSON object of a body."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated, Any, cast

from fastapi import Depends, Path
from starlette.requests import HTTPConnection, Request

from lidarcodec.errors import SettingsError
from lidarcodec.settings import MAX_NAME, NAME_PATTERN
from lidarcodec.transport.keys import StreamKeys
from lidarcodec.untrusted.json import JsonRefusedError, read_object
from lidarcodec_server.fleet.fleet import Stream
from lidarcodec_server.middleware import NEEDS_JSON, is_json
from lidarcodec_server.problems import ProblemError
from lidarcodec_server.service import Service

Name = Annotated[str, Path(pattern=f"^{NAME_PATTERN.pattern}$", max_length=MAX_NAME, examples=["car-7"])]


def service_of(connection: HTTPConnection) -> Service:
    """The service of the app."""
    return cast(Service, connection.app.state.service)


def stream_of(vehicle: Name, sensor: Name) -> StreamKeys:
    """The stream in a path."""
    return StreamKeys(vehicle, sensor)


def known_stream(service: Service, keys: StreamKeys, remedy: str = "GET /api/v1/streams lists all") -> Stream:
    """A stream as the server knows it. remedy: what to do if it was never seen

    Raises ProblemError 404 if it was never seen.
    """
    found = service.stream(keys)
    if found is None:
        detail = f"stream {keys.vehicle}/{keys.sensor} was never seen here: {remedy}"
        raise ProblemError(404, detail, "unknown-stream")
    return found


def time_of(stamp_ns: int) -> datetime:
    """A time in ns since the Unix epoch.

    Raises SettingsError for one that no calendar has.
    """
    try:
        return datetime.fromtimestamp(stamp_ns / 1e9, UTC)
    except (ValueError, OverflowError):
        raise SettingsError("the time is out of range", "from") from None


async def json_object(request: Request) -> dict[str, Any]:
    """The JSON object of a body.

    Raises ProblemError 415 for another content type, because a web page of another origin can make a browser send text
    but not JSON; 422 for a body that is no JSON object.
    """
    content = request.headers.get("content-type", "")
    if not content or not is_json(content):
        raise ProblemError(415, NEEDS_JSON, "content-type")
    try:
        return read_object(await request.body())
    except JsonRefusedError as error:
        raise ProblemError(422, f"cannot read the body: {error}", "request") from None


TheService = Annotated[Service, Depends(service_of)]
TheStream = Annotated[StreamKeys, Depends(stream_of)]
JsonObject = Annotated[dict[str, Any], Depends(json_object)]
