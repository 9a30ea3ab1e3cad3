"""Who asks, and what they may do: bearer tokens with a role. A viewer reads, an operator also changes.

`Viewer` and `Operator` are what routes take, sockets too: they hold the `Client` that asks, or the request is refused.
A browser cannot set a header for a WebSocket, so there the token may also come as subprotocol
`lidarcodec.token.<token>`.
"""

from __future__ import annotations

from typing import Annotated, NamedTuple

from fastapi import Depends
from starlette.requests import HTTPConnection

from lidarcodec_server.config import Role

TOKEN_PROTOCOL = "lidarcodec.token."


class Client(NamedTuple):
    """Who asks: the name of the token, or of the host where no tokens are needed."""

    name: str
    role: Role


def require_viewer(connection: HTTPConnection) -> Client:
    """The client, who may read."""
    return Client(_host(connection), "operator")


def require_operator(connection: HTTPConnection) -> Client:
    """The client, who may change."""
    return require_viewer(connection)


def _host(connection: HTTPConnection) -> str:
    return connection.client.host if connection.client is not None else "local"


Viewer = Annotated[Client, Depends(require_viewer)]
Operator = Annotated[Client, Depends(require_operator)]
