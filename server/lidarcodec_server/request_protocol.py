"""The HTTP protocol of the server: one that lets no client that asks nothing keep a connection for ever.

A server has so many connections and no more. Whoever could hold them all without a request would need no token to keep
everybody else out.
"""

from __future__ import annotations

import asyncio
from typing import Final

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

REQUEST_S: Final = 10.0
"""So soon a connection's first request has to be there, up to its body, and the next one after an answer."""


class RequestProtocol(H11Protocol):
    """Ends a connection when its next request does not come whole in time."""

    _due: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Wait for the first request."""
        super().connection_made(transport)
        self._expect()

    def handle_events(self) -> None:
        """Take what came: once it is a request, how long its body may take is the application's matter."""
        super().handle_events()
        if self.cycle is not None and not self.cycle.response_complete:
            self._forget()

    def on_response_complete(self) -> None:
        """Wait for the next request, which may be there already."""
        self._expect()
        super().on_response_complete()

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        """It is a WebSocket from now on, and no matter of ours."""
        self._forget()
        super().handle_websocket_upgrade(event)

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the connection."""
        self._forget()
        super().connection_lost(exc)

    def _expect(self) -> None:
        self._forget()
        self._due = self.loop.call_later(REQUEST_S, self._end)

    def _forget(self) -> None:
        if self._due is not None:
            self._due.cancel()
            self._due = None

    def _end(self) -> None:
        """Close the connection; what the client has not read of the last answer so long afterwards is thrown away."""
        self.transport.close()
        self._due = self.loop.call_later(REQUEST_S, self.transport.abort)
