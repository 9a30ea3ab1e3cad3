"""Errors as RFC 9457 problems (`application/problem+json`), for all error answers.

A problem's `type` is `urn:lidarcodec:problem:NAME` for our own problems and `about:blank` for general ones of HTTP. The
answer to an unexpected exception has only an `instance`; the log has the exception under this id.
"""

from __future__ import annotations

import json
import logging
import uuid
from http import HTTPStatus
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, HTTPConnection
from starlette.responses import Response
from starlette.websockets import WebSocket, WebSocketState

from lidarcodec.errors import (
    LidarCodecError,
    MissingExtraError,
    SettingsError,
    TransportError,
    UnknownNameError,
    reason_of,
    sentence_of,
)
from lidarcodec.transport.answering import field_of
from lidarcodec_server.fleet.answers import AwayError, RefusedError
from lidarcodec_server.fleet.turns import BusyError
from lidarcodec_server.limits import SparseLog, TooManyError
from lidarcodec_server.migrations import StoreError

logger = logging.getLogger(__name__)
_sparse = SparseLog(logger)

MEDIA_TYPE = "application/problem+json"
TYPE_PREFIX = "urn:lidarcodec:problem:"
MAX_ERRORS = 20
TOLD = "lidarcodec.problem"
"""Key in the scope of a request for the reason of its refusal, for the audit log."""
MAX_REASON = 500
NAMES: tuple[tuple[type[LidarCodecError], int, str], ...] = (
    (RefusedError, 422, "refused"),
    (SettingsError, 422, "settings"),
    (UnknownNameError, 422, "settings"),
    (TransportError, 503, "network"),
    (MissingExtraError, 503, "extra"),
    (AwayError, 503, "vehicle-away"),
    (BusyError, 503, "busy"),
    (StoreError, 503, "store"),
)
"""Status and name of the problem for each of our errors; all other errors are unexpected."""


class ProblemError(Exception):
    """An error answer.

    name: the NAME in `urn:lidarcodec:problem:NAME`; None if the status alone says enough
    extra: further members, such as `field`
    """

    def __init__(
        self, status: int, detail: str, name: str | None = None, headers: dict[str, str] | None = None, **extra: Any
    ) -> None:
        super().__init__(detail)
        self.status, self.detail, self.name = status, detail, name
        self.headers, self.extra = headers or {}, extra

    def response(self) -> Response:
        """The answer. It is escaped to ASCII, because a detail may quote a lone surrogate from a request."""
        body = {
            "type": "about:blank" if self.name is None else TYPE_PREFIX + self.name,
            "title": HTTPStatus(self.status).phrase,
            "status": self.status,
            "detail": self.detail,
            **{name: value for name, value in self.extra.items() if value is not None},
        }
        return Response(json.dumps(body), self.status, self.headers, media_type=MEDIA_TYPE)


def unexpected(error: BaseException, what: str) -> ProblemError:
    """A problem with only an id; the log has the details under this id."""
    instance = uuid.uuid4()
    logger.error("%s failed (%s)", what, instance, exc_info=error)
    return ProblemError(
        500, "unexpected error; the server's log has details under this instance", instance=f"urn:uuid:{instance}"
    )


def of(error: LidarCodecError) -> ProblemError | None:
    """The problem of one of our errors; None for an unexpected one."""
    for kind, status, name in NAMES:
        if isinstance(error, kind):
            detail = str(error)
            if isinstance(error, StoreError):  # the address of the database is private
                _sparse.warning("%s", error)
                detail = "the database does not answer; the log has the reason"
            headers = {"Retry-After": "2"} if status == 503 else None
            return ProblemError(status, detail, name, headers, field=field_of(error))
    return None


def _validation(error: RequestValidationError) -> ProblemError:
    errors = [
        {"in": str(one["loc"][0]), "field": ".".join(str(part) for part in one["loc"][1:]), "reason": reason_of(one)}
        for one in error.errors()[:MAX_ERRORS]
    ]
    first = errors[0] if errors else {"in": "request", "field": "", "reason": "not valid"}
    where = f"{first['field']} ({first['in']})" if first["field"] else first["in"]
    text = sentence_of(where, error.errors()[0]) if errors else f"{where}: {first['reason']}"
    return ProblemError(422, text, "request", field=first["field"] or None, errors=errors)


def problem_of(error: Exception, what: str) -> ProblemError:
    """The problem for any exception."""
    if isinstance(error, ProblemError):
        return error
    if isinstance(error, RequestValidationError):
        return _validation(error)
    if isinstance(error, HTTPException):
        if isinstance(error.__cause__, ProblemError):  # raised while the framework read the body
            return error.__cause__
        headers = dict(error.headers or {})
        detail = str(error.detail)
        if detail == HTTPStatus(error.status_code).phrase:  # of the framework, which only repeats the title
            allowed = headers.get("Allow", "another method")
            said = {404: "there is no such address; /docs lists all", 405: f"this address takes {allowed}"}
            detail = f"{what}: {said[error.status_code]}" if error.status_code in said else detail
        return ProblemError(error.status_code, detail, headers=headers)
    if isinstance(error, TooManyError):
        return ProblemError(429, str(error), "too-many", {"Retry-After": str(error.wait_s)})
    if isinstance(error, ClientDisconnect):  # no client reads the answer, and it is not an error
        return ProblemError(400, "the body is incomplete")
    known = of(error) if isinstance(error, LidarCodecError) else None
    return known or unexpected(error, what)


async def answer(connection: HTTPConnection, error: Exception) -> Response | None:
    """Answer a request, or refuse a WebSocket, with the problem of an exception."""
    problem = problem_of(error, f"{connection.scope.get('method', 'WS')} {connection.scope['path']}")
    connection.scope[TOLD] = problem.detail[:MAX_REASON]
    if not isinstance(connection, WebSocket):
        return problem.response()
    if connection.application_state is WebSocketState.CONNECTING:
        await connection.send_denial_response(problem.response())
    else:
        await connection.close(1008 if problem.status < 500 else 1011, problem.detail[:120])
    return None


def install(app: FastAPI) -> None:
    """Make an app answer every error with a problem."""

    async def handle(request: Request, error: Exception) -> Response:
        return await answer(request, error)  # type: ignore[return-value] # (a WebSocket takes None)

    for kind in (ProblemError, RequestValidationError, HTTPException, LidarCodecError, Exception):
        app.add_exception_handler(kind, handle)
