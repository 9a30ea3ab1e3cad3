"""Fair: limits the requests of a client that are processed at once; others wait for their turn.

Otherwise a client that sends requests all the time over many connections would slow down all others. A client is a
host, or a token on a host: tokens on one host do not wait for each other.
Health checks and live sockets do not count; sockets have their own limits. The time to receive a body or to send an
answer does not count either: `middleware.BodyLimit` comes before this.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable

from starlette.requests import HTTPConnection
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from lidarcodec_server.door.connections import host_of
from lidarcodec_server.middleware import HEALTH, refuse
from lidarcodec_server.problems import ProblemError


class Fair:
    """Processes `most` requests of a client at once; a request that waits longer than `wait_s` is refused."""

    def __init__(
        self,
        app: ASGIApp,
        most: int,
        wait_s: float,
        proxies: Iterable[str] = (),
        who: Callable[[HTTPConnection], str] = lambda _: "",
    ) -> None:
        """who: gives the name of a client with a valid token, otherwise an empty text"""
        self._app, self._most, self._wait_s, self._who = app, most, wait_s, who
        self._proxies = frozenset(host_of(one) for one in proxies)
        self._turns: dict[tuple[str, str], tuple[asyncio.Semaphore, int]] = {}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or scope["path"] in HEALTH:
            await self._app(scope, receive, send)
            return
        connection = HTTPConnection(scope)
        host = "local" if connection.client is None else host_of(connection.client.host)
        if host in self._proxies:
            await self._app(scope, receive, send)
            return
        key = host, self._who(connection)
        turn, users = self._turns.get(key, (asyncio.Semaphore(self._most), 0))
        self._turns[key] = turn, users + 1
        try:
            await self._in_turn(turn, scope, receive, send)
        finally:
            users = self._turns[key][1] - 1
            if users:
                self._turns[key] = turn, users
            else:
                del self._turns[key]

    async def _in_turn(self, turn: asyncio.Semaphore, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            await asyncio.wait_for(turn.acquire(), self._wait_s)
        except TimeoutError:
            detail = f"at most {self._most} requests of this client are allowed at once: try again"
            await refuse(scope, receive, send, ProblemError(429, detail, "too-many", {"Retry-After": "1"}))
            return
        held = True

        def done() -> None:
            nonlocal held
            if held:
                held = False
                turn.release()

        async def answer(message: Message) -> None:
            if message["type"] == "http.response.start":  # processing is over: reading the answer does not count
                done()
            await send(message)

        try:
            await self._app(scope, receive, answer)
        finally:
            done()
