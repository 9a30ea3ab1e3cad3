"""Operations: every changing request of an operator gets exactly one entry in the audit log.

A route that changes something takes `Annotated[Operation, operates("keyframe")]`. Then only operators may use it, and
`Audit` writes the entry, done or refused, before the answer is sent. Code that writes an entry of its own calls
`entered`. Requests above a client's rate limit share one entry a minute (`refusals`). Requests of clients without
permission are counted and logged, but get no entry, because they would fill the log.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, cast

from fastapi import Depends
from starlette.concurrency import run_in_threadpool
from starlette.requests import HTTPConnection
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from lidarcodec.errors import SettingsError
from lidarcodec.settings import valid_name
from lidarcodec.transport.keys import StreamKeys
from lidarcodec_server.auth import require_operator
from lidarcodec_server.limits import TooManyError
from lidarcodec_server.middleware import REFUSED
from lidarcodec_server.problems import TOLD
from lidarcodec_server.service import Service
from lidarcodec_server.tokens import Client

KEY = "lidarcodec.operations"


@dataclass
class Operation:
    """A changing request of an operator.

    keys:    its stream, or None;  about: the request, for the log
    reason:  why it was refused;  first_frame: the first frame with the change
    is_entered: whether it has an entry in the log;  too_soon: whether a rate limit refused it
    """

    client: Client
    action: str
    keys: StreamKeys | None = None
    about: dict[str, Any] = field(default_factory=dict)
    reason: str | None = None
    first_frame: int | None = None
    is_entered: bool = False
    too_soon: bool = False

    def entered(self) -> None:
        """An entry was written."""
        self.is_entered = True


def operates(action: str) -> Any:
    """A dependency of routes for operators: the operation, with `action` as its name in the audit log."""

    def operation(connection: HTTPConnection) -> Operation:
        return begun(connection, action)

    return Depends(operation)


def begun(connection: HTTPConnection, action: str) -> Operation:
    """The operation of a request, for a route that finds out late that it changes something.

    Raises ProblemError 401, 403 for a client that is no operator, TooManyError.
    """
    made = Operation(require_operator(connection), action, *_concerns(connection.path_params))
    connection.scope[KEY].append(made)
    try:
        cast(Service, connection.app.state.service).limits.change(made.client.name)
    except TooManyError:
        made.too_soon = True
        raise
    if REFUSED in connection.scope:
        raise connection.scope[REFUSED]
    return made


class Audit:
    """Writes the audit entry of an operation before its answer is sent, unless it has one already."""

    def __init__(self, app: ASGIApp, enter: Callable[[Operation, str], object]) -> None:
        """enter: writes an entry with a result; blocks, and raises no LidarCodecError"""
        self._app, self._enter = app, enter

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        operations: list[Operation] = []
        scope[KEY] = operations

        async def entering(message: Message) -> None:
            if message["type"] == "http.response.start":
                for operation in operations:
                    operation.reason = scope.get(TOLD)
                await self._all(operations, _result(message["status"]))
            await send(message)

        try:
            await self._app(scope, receive, entering)
        except Exception:  # an unexpected error; the outer layer answers it
            await self._all(operations, "failed")
            raise
        finally:
            await self._all(operations, "sent")  # there was no answer, so the result is unknown

    async def _all(self, operations: list[Operation], result: str) -> None:
        for operation in operations:
            if not operation.is_entered:
                operation.entered()
                await run_in_threadpool(self._enter, operation, result)


def _result(status: int) -> str:
    return "done" if status < 400 else "refused" if status < 500 else "failed"


def _concerns(path: dict[str, str]) -> tuple[StreamKeys | None, dict[str, Any]]:
    """The stream and the recording in the parameters of a path."""
    about = {"recording": path["id"][:64]} if "id" in path else {}
    try:
        keys = StreamKeys(valid_name(path["vehicle"], "vehicle"), valid_name(path["sensor"], "sensor"))
    except (KeyError, SettingsError):
        return None, about
    return keys, about
