"""What routes of the live side share: the hub, the recordings, and whether a stream is there to be looked at."""

from __future__ import annotations

from typing import Annotated, cast

from fastapi import Depends
from starlette.requests import HTTPConnection

from lidarcodec.filling import fills_for
from lidarcodec_server.fleet.fleet import Stream
from lidarcodec_server.live.hub import LiveHub
from lidarcodec_server.live.recordings import Recordings
from lidarcodec_server.routes.common import TheService, TheStream, known_stream


def hub_of(connection: HTTPConnection) -> LiveHub:
    """The hub of the app that answers."""
    return cast(LiveHub, connection.app.state.hub)


def recordings_of(connection: HTTPConnection) -> Recordings:
    """The recordings of the app that answers."""
    return cast(Recordings, connection.app.state.recordings)


def known(service: TheService, keys: TheStream) -> Stream:
    """What is known of the stream of a path; asked in a thread, because the store may be.

    Raises ProblemError 404 when it was never seen.
    """
    return known_stream(service, keys)


def fills(known: Annotated[Stream, Depends(known)], recordings: Annotated[Recordings, Depends(recordings_of)]) -> bool:
    """Whether returns of a stream are made up between the columns that were sent, unless a viewer says otherwise: not
    of a recording that is played, and not for programs."""
    _, played = recordings.names()
    return known.keys not in played and (known.settings is None or fills_for(known.settings.purpose))


Hub = Annotated[LiveHub, Depends(hub_of)]
TheRecordings = Annotated[Recordings, Depends(recordings_of)]
Known = Annotated[Stream, Depends(known)]
Fills = Annotated[bool, Depends(fills)]
