"""What routes share: the service of the app, and the stream that a path names."""

from __future__ import annotations

from typing import Annotated, cast

from fastapi import Depends, Path
from starlette.requests import HTTPConnection

from lidarcodec.settings import NAME_PATTERN
from lidarcodec.transport.keys import StreamKeys
from lidarcodec_server.service import Service

Name = Annotated[str, Path(pattern=f"^{NAME_PATTERN.pattern}$", examples=["car-7"])]


def service_of(connection: HTTPConnection) -> Service:
    """The service of the app that answers."""
    return cast(Service, connection.app.state.service)


def stream_of(vehicle: Name, sensor: Name) -> StreamKeys:
    """The stream of a path."""
    return StreamKeys(vehicle, sensor)


TheService = Annotated[Service, Depends(service_of)]
TheStream = Annotated[StreamKeys, Depends(stream_of)]
