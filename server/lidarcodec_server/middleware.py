"""The checks of every request before its route: its origin and its length. It also measures the time of the answer.

Plain ASGI, because the framework's own middleware buffers bodies and breaks WebSockets.
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
"""Key in the scope of a request for the reason why its body is refused; the body is then empty."""
NO_BODY: Message = {"type": "http.request", "body": b"", "more_body": False}
NEEDS_JSON = "the body must be JSON: send Content-Type: application/json"
GUARDED, SESSION = "/api/v1/", "/api/v1/session"
"""The API: all its paths but one need a token, once there are tokens."""
ELSEWHERE = ("cross-site", "same-site")
"""Values of Sec-Fetch-Site for requests by a page of another origin. `same-site` can be another port of this
machine."""
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
    """On connections in the reserved places, refuses all requests but health checks and those of operators.

    It never waits: it uses the tokens that were read last.
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
    """Refuses requests that a web page of another origin makes in a browser.

    As long as there are no tokens, a browser on this machine needs none; a page from elsewhere must not use that. Such
    a page can send changing requests and open WebSockets, but it cannot set `Origin`. It can resolve its own name to
    this machine (DNS rebinding), but it cannot set `Host`. It must not show a picture from here either. For pictures
    browsers send no `Origin`; they send `Sec-Fetch-Site` and obey Cross-Origin-Resource-Policy. It may lead the
    browser to our page, but not to the API, where a GET may begin a fetch.
    """

    def __init__(self, app: ASGIApp, needs_local_host: Callable[[], bool]) -> None:
        """needs_local_host: whether `Host` must be this machine, because no token is needed"""
        self._app, self._needs_local_host = app, needs_local_host

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] in ("http", "websocket"):
            reason = self._reason(scope, Headers(scope=scope), page=not scope["path"].startswith(GUARDED))
            if reason is not None:
                await refuse(scope, receive, send, ProblemError(403, reason, "origin"))
                return
        await self._app(scope, receive, send)

    def _reason(self, scope: Scope, headers: Headers, *, page: bool) -> str | None:
        host = headers.get("host", "")
        if self._needs_local_host() and not is_loopback(_hostname(host)):
            return "without any token, this server answers only to localhost and its addresses"
        led_here = page and headers.get("sec-fetch-mode") == "navigate"
        if headers.get("sec-fetch-site") in ELSEWHERE and not led_here:
            return "a page of another origin may not read anything here"
        origin = headers.get("origin")
        if origin is None or (scope["type"] == "http" and scope["method"] in SAFE):
            return None
        if origin.lower().partition("://")[2] != host.lower():
            return "a page of another origin may not change anything here"
        return None


def _hostname(host: str) -> str:
    """The name in a Host header. Without one (HTTP/1.0) it is this machine."""
    try:
        return urlsplit(f"//{host}").hostname or ("" if host else "localhost")
    except ValueError:
        return ""


class Knock:
    """Refuses clients without permission, before any work is done for a request."""

    def __init__(self, app: ASGIApp, check: Callable[[HTTPConnection], Awaitable[object]]) -> None:
        """check: raises ProblemError for a client without permission"""
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
    """Refuses bodies that are too long, too slow, or not JSON.

    A JSON body is read completely and checked before its request is processed. Other bodies are not read. If a changing
    request has a refused body, its route (`operations.operates`) refuses it and writes the audit entry.
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
            if not more:  # the body is complete: from here on it only waits for the client to disconnect
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
        """Raise ProblemError for a body that can be refused before it is read."""
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
    """Whether a content type means JSON. A body without a content type counts as JSON."""
    content = content_type.partition(";")[0].strip().lower()
    return not content or content == "application/json" or content.endswith("+json")


async def refuse(scope: Scope, receive: Receive, send: Send, problem: ProblemError) -> None:
    """Answer with a problem, without looking for a route."""
    if scope["type"] == "websocket":
        await receive()  # the request to connect
        if "websocket.http.response" not in scope.get("extensions", {}):
            await send({"type": "websocket.close", "code": 1008, "reason": problem.detail[:120]})
            return
    await problem.response()(scope, receive, send)
