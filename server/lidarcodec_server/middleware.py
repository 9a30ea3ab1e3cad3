"""What every request goes through before it meets a route: is it from here, is it too long, how long did it take.

Plain ASGI, because the framework's own kind holds bodies and breaks WebSockets.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.requests import HTTPConnection
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from lidarcodec.untrusted.json import JsonRefusedError, read_json
from lidarcodec_server.config import is_loopback
from lidarcodec_server.metrics.metrics import Metrics
from lidarcodec_server.problems import ProblemError

HEALTH = ("/healthz", "/readyz")
REFUSED = "lidarcodec.refused"
"""Where the scope of a request has why its body is refused; the body is then empty."""
NO_BODY: Message = {"type": "http.request", "body": b"", "more_body": False}
NEEDS_JSON = "the body must be JSON: send Content-Type: application/json"
GUARDED, SESSION = "/api/v1/", "/api/v1/session"
"""Where every path but one needs a token, once there are tokens."""
ELSEWHERE = ("cross-site", "same-site")
"""As browsers say it of a request by a page of another origin; another port of this machine is the `same-site`."""
SAFE = ("GET", "HEAD", "OPTIONS")
HEADERS = (
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"x-frame-options", b"DENY"),
    (b"cross-origin-resource-policy", b"same-origin"),
)


class Observe:
    """Counts requests and their times, and sets the headers that every answer has."""

    def __init__(self, app: ASGIApp, metrics: Metrics) -> None:
        self._app, self._metrics = app, metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        start, status = time.perf_counter(), 500

        async def observed(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                message["headers"] = [*message.get("headers", []), *HEADERS]
            await send(message)

        try:
            await self._app(scope, receive, observed)
        finally:
            route = getattr(scope.get("route"), "path", "none")
            self._metrics.request(scope["method"], route, status, time.perf_counter() - start)


class Reserved:
    """Refuses whatever is neither a health check nor an operator's, on connections in the reserved places.

    Nobody waits here for anything: the tokens are those that were known last.
    """

    def __init__(self, app: ASGIApp, is_operator: Callable[[HTTPConnection], bool]) -> None:
        self._app, self._is_operator = app, is_operator

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        reserved = scope["type"] in ("http", "websocket") and scope.get("state", {}).get("reserved", False)
        if not reserved:
            await self._app(scope, receive, send)
            return
        if scope["path"] not in HEALTH and not self._is_operator(HTTPConnection(scope)):
            headers = {"Retry-After": "10", "Connection": "close"}
            detail = "the limit of connections is reached: try again, or use the token of an operator"
            await refuse(scope, receive, send, ProblemError(503, detail, "connections", headers))
            return
        if scope["type"] == "websocket":
            await self._app(scope, receive, send)
            return

        async def closing(message: Message) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message.get("headers", []), (b"connection", b"close")]
            await send(message)

        await self._app(scope, receive, closing)


class FromHere:
    """Refuses what a web page of another origin makes a browser do.

    A browser on this machine is let in without a token as long as there are none; a page from elsewhere must not
    use that. It can make the browser change things and open WebSockets, but not lie about `Origin`; and it can have its
    own name lead to this machine, but not lie about `Host`. Nor may it show a picture from here. Browsers send no
    `Origin` for those; they send `Sec-Fetch-Site`, and heed Cross-Origin-Resource-Policy.
    """

    def __init__(self, app: ASGIApp, needs_local_host: Callable[[], bool]) -> None:
        """needs_local_host: whether only this machine may be meant, because nobody needs a token"""
        self._app, self._needs_local_host = app, needs_local_host

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] in ("http", "websocket"):
            reason = self._reason(scope, Headers(scope=scope))
            if reason is not None:
                await refuse(scope, receive, send, ProblemError(403, reason, "origin"))
                return
        await self._app(scope, receive, send)

    def _reason(self, scope: Scope, headers: Headers) -> str | None:
        host = headers.get("host", "")
        if self._needs_local_host() and not is_loopback(_hostname(host)):
            return "without any token, this server answers only to localhost and its addresses"
        if headers.get("sec-fetch-site") in ELSEWHERE and headers.get("sec-fetch-mode") != "navigate":
            return "a page of another origin may not read anything here"
        origin = headers.get("origin")
        if origin is None or (scope["type"] == "http" and scope["method"] in SAFE):
            return None
        if origin.lower().partition("://")[2] != host.lower():
            return "a page of another origin may not change anything here"
        return None


def _hostname(host: str) -> str:
    """The name in a Host header; none is this machine's (HTTP/1.0)."""
    try:
        return urlsplit(f"//{host}").hostname or ("" if host else "localhost")
    except ValueError:
        return ""


class Knock:
    """Refuses clients without permission, before any work is done for a request."""

    def __init__(self, app: ASGIApp, check: Callable[[HTTPConnection], Awaitable[object]]) -> None:
        """check: raises ProblemError for a client that may not"""
        self._app, self._check = app, check

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] in ("http", "websocket") and scope["path"].startswith(GUARDED) and scope["path"] != SESSION:
            try:
                await self._check(HTTPConnection(scope))
            except ProblemError as problem:
                await refuse(scope, receive, send, problem)
                return
        await self._app(scope, receive, send)


class BodyLimit:
    """Refuses bodies that are too long, that take too long to come, or that are no JSON.

    A body of JSON is read whole and checked before anything is done for its request. Another one is never waited for.
    What is refused of a request that changes something is left to its route (`operations.operates`), which enters it.
    """

    def __init__(self, app: ASGIApp, max_bytes: int, limit_s: float) -> None:
        self._app, self._max, self._limit_s = app, max_bytes, limit_s

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        told = headers.get("content-length", "0")
        if not told.isascii() or not told.isdigit() or len(told) > 18:
            await refuse(scope, receive, send, ProblemError(400, "Content-Length is not a number"))
            return
        end, size, more = time.monotonic() + self._limit_s, 0, True

        async def limited() -> Message:
            nonlocal size, more
            if not more:  # from here on, waiting means waiting for the client to disconnect
                return await receive()
            try:
                message = await asyncio.wait_for(receive(), max(0.0, end - time.monotonic()))
            except TimeoutError:
                raise ProblemError(408, f"the body did not arrive within {self._limit_s:g} s") from None
            size += len(message.get("body", b""))
            if size > self._max:
                raise self._too_long()
            more = message.get("more_body", False)
            return message

        first: Message | None = NO_BODY
        if int(told) > 0 or "transfer-encoding" in headers:
            try:
                self._check(int(told), headers.get("content-type", ""))
                first = await self._json(limited)
            except ProblemError as problem:
                if scope["method"] in SAFE:
                    await refuse(scope, receive, send, problem)
                    return
                scope[REFUSED] = problem

        async def read() -> Message:
            nonlocal first
            message, first = first, None
            return await receive() if message is None else message

        await self._app(scope, read, send)

    def _check(self, told: int, content_type: str) -> None:
        """Raise ProblemError for a body that need not be waited for."""
        if told > self._max:
            raise self._too_long()
        if not is_json(content_type):
            raise ProblemError(415, NEEDS_JSON, "content-type")

    async def _json(self, limited: Receive) -> Message:
        parts: list[bytes] = []
        while True:
            message = await limited()
            if message["type"] != "http.request":
                return message
            parts.append(message.get("body", b""))
            if not message.get("more_body", False):
                break
        body = b"".join(parts)
        if body:
            try:
                read_json(body, self._max)
            except JsonRefusedError as error:
                raise ProblemError(422, f"cannot read the body: {error}", "request") from None
        return {"type": "http.request", "body": body, "more_body": False}

    def _too_long(self) -> ProblemError:
        return ProblemError(413, f"the body is larger than {self._max} bytes", "too-long")


def is_json(content_type: str) -> bool:
    """Whether a body is said to be JSON; one that nothing is said of is taken for it."""
    content = content_type.partition(";")[0].strip().lower()
    return not content or content == "application/json" or content.endswith("+json")


async def refuse(scope: Scope, receive: Receive, send: Send, problem: ProblemError) -> None:
    """Answer with a problem, before any route is looked for."""
    if scope["type"] == "websocket":
        await receive()  # the request to connect
        if "websocket.http.response" not in scope.get("extensions", {}):
            await send({"type": "websocket.close", "code": 1008, "reason": problem.detail[:120]})
            return
    await problem.response()(scope, receive, send)
