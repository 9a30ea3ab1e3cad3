"""Authentication with bearer tokens, each with a role. A viewer may read, an operator may also change settings.

Routes and sockets take a `Viewer`: it is the `Client` that sends the request; without one the request is refused.
Routes that change something take an `operations.Operation`.
A browser cannot set a header for a WebSocket, so there the token may also come as subprotocol
`lidarcodec.token.<token>`; `subprotocol_of` gives the subprotocol with which to accept such a socket.
"""

from __future__ import annotations

from typing import Annotated, cast

from fastapi import Depends
from starlette.concurrency import run_in_threadpool
from starlette.requests import HTTPConnection

from lidarcodec_server.problems import ProblemError
from lidarcodec_server.service import Service
from lidarcodec_server.tokens import Client

TOKEN_PROTOCOL = "lidarcodec.token."
SAFE = ("GET", "HEAD", "OPTIONS")
CHALLENGE = {"WWW-Authenticate": 'Bearer realm="lidarcodec"'}


def require_viewer(connection: HTTPConnection) -> Client:
    """The client, if it is allowed to read.

    Raises ProblemError 401 if tokens are needed and the request has no valid one.
    """
    service = cast(Service, connection.app.state.service)
    if not service.tokens.needed:
        return Client(host(connection), "operator")
    token = _token(connection)
    if token is None:
        raise _missing(service)
    client = service.tokens.client(token)
    if client is None:
        service.metrics.refused("wrong")
        service.warnings.warning("a wrong token from %s", host(connection))
        raise ProblemError(401, "this token is not valid", "token", CHALLENGE)
    return client


def require_operator(connection: HTTPConnection) -> Client:
    """The client, if it is allowed to change settings.

    Raises ProblemError 401 as `require_viewer`, 403 for a viewer.
    """
    client = require_viewer(connection)
    _check_role(connection, client)
    return client


async def check(connection: HTTPConnection) -> None:
    """Check the token before the body is read and before the request gets a turn. This is cheap without a token and for
    known tokens.

    Raises ProblemError as `require_operator` and `require_viewer`.
    """
    service = cast(Service, connection.app.state.service)
    if not service.tokens.seen:
        return
    token = _token(connection)
    if token is None:
        raise _missing(service)
    client = service.tokens.seen_client(token)
    if client is None:  # it may be a new token
        client = await run_in_threadpool(require_viewer, connection)
    if connection.scope["type"] == "http" and connection.scope["method"] not in SAFE:
        _check_role(connection, client)


def asks(connection: HTTPConnection) -> str:
    """The name of the client, if its token is known to be valid. Does not read the store, never blocks."""
    token = _token(connection)
    return (None if token is None else cast(Service, connection.app.state.service).tokens.owner(token)) or ""


def known_operator(connection: HTTPConnection) -> bool:
    """Whether the token of a request is known to be an operator's. Does not read the store, never blocks."""
    service = cast(Service, connection.app.state.service)
    token = _token(connection)
    client = None if token is None else service.tokens.seen_client(token)
    return client is not None and client.role == "operator"


def offers_token(connection: HTTPConnection) -> bool:
    """Whether the client sent a token, valid or not."""
    return _token(connection) is not None


def subprotocol_of(connection: HTTPConnection) -> str | None:
    """The subprotocol to accept a WebSocket with. It is sent back, so one that is not a token is preferred."""
    offered = _protocols(connection)
    return next((name for name in offered if not name.startswith(TOKEN_PROTOCOL)), offered[0] if offered else None)


def _missing(service: Service) -> ProblemError:
    service.metrics.refused("missing")
    return ProblemError(401, "a token is needed: send the header Authorization: Bearer TOKEN", "token", CHALLENGE)


def _check_role(connection: HTTPConnection, client: Client) -> None:
    if client.role != "operator":
        service = cast(Service, connection.app.state.service)
        service.metrics.refused("role")
        service.warnings.warning("%s of %s is a viewer and tried to change something", client.name, host(connection))
        raise ProblemError(
            403, f"'{client.name}' is the token of a viewer: this needs the token of an operator", "role"
        )


def _token(connection: HTTPConnection) -> str | None:
    scheme, _, token = connection.headers.get("authorization", "").partition(" ")
    if scheme.lower() == "bearer" and token.strip():
        return token.strip()
    if connection.scope["type"] == "websocket":
        for name in _protocols(connection):
            if name.startswith(TOKEN_PROTOCOL):
                return name.removeprefix(TOKEN_PROTOCOL)
    return None


def _protocols(connection: HTTPConnection) -> list[str]:
    given = connection.headers.get("sec-websocket-protocol", "")
    return [name.strip() for name in given.split(",") if name.strip()]


def host(connection: HTTPConnection) -> str:
    """The address of a client."""
    return connection.client.host if connection.client is not None else "local"


Viewer = Annotated[Client, Depends(require_viewer)]
