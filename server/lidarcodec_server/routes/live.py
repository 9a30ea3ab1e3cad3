"""Shared by the routes for live streams: the hub, the recordings, and whether a stream is known."""

from __future__ import annotations

from typing import Annotated, cast

from fastapi import Depends
from starlette.requests import HTTPConnection

from lidarcodec.filling import fills_for
from lidarcodec_server.fleet.fleet import Stream
from lidarcodec_server.live.download import Downloads
from lidarcodec_server.live.hub import LiveHub
from lidarcodec_server.live.recordings import Recordings
from lidarcodec_server.routes.common import TheService, TheStream, known_stream


def hub_of(connection: HTTPConnection) -> LiveHub:
    """The hub of the app."""
    return cast(LiveHub, connection.app.state.hub)


def recordings_of(connection: HTTPConnection) -> Recordings:
    """The recordings of the app."""
    return cast(Recordings, connection.app.state.recordings)


def downloads_of(connection: HTTPConnection) -> Downloads:
    """The places for downloads of the app."""
    return cast(Downloads, connection.app.state.downloads)


def known(service: TheService, keys: TheStream) -> Stream:
    """The stream in a path. Called in a thread, because it may read the store.

    Raises ProblemError 404 if it was never seen.
    """
    return known_stream(service, keys)


def fills(known: Annotated[Stream, Depends(known)], recordings: Annotated[Recordings, Depends(recordings_of)]) -> bool:
    """Whether returns are interpolated between the sent columns, unless a viewer says otherwise. Not for a playback
    of a recording, and not for programs."""
    _, played = recordings.names()
    return known.keys not in played and (known.settings is None or fills_for(known.settings.purpose))


Hub = Annotated[LiveHub, Depends(hub_of)]
TheDownloads = Annotated[Downloads, Depends(downloads_of)]
TheRecordings = Annotated[Recordings, Depends(recordings_of)]
Known = Annotated[Stream, Depends(known)]
Fills = Annotated[bool, Depends(fills)]
