"""The HTTP protocol of the server. It closes the connections of clients that send no request.

The number of connections is limited. If a client could keep all of them without a request, it could block the server
without a token.
"""

from __future__ import annotations

import asyncio
from http import HTTPStatus
from typing import Any, NamedTuple

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

from lidarcodec_server.door.connections import Connections, Place

RESERVED_S = 2.0
"""The same as `request_s`, for a connection in one of the reserved places."""


MAX_HEAD_BYTES = 16 * 1024
"""Largest head of a request, and largest trailer after a body in chunks, in bytes."""
MAX_HEADERS = 100
"""Most header fields of a request; a browser sends twenty."""
TOO_LARGE = 431
CHUNKS, CHUNK_BYTES = 64, 64
"""Most chunks of a body, and bytes that allow one more: parsing a chunk takes as long as receiving 10 kB."""
LATE_BYTES = 1024 * 1024
"""Most bytes of a body that are read and discarded after its request was answered."""


class Parser(h11.Connection):
    """Refuses requests of many small parts, because they are slow to parse, and requests that a proxy may divide at
    another place (request smuggling).

    refused: status of the refusal
    """

    def __init__(self) -> None:
        super().__init__(h11.SERVER, MAX_HEAD_BYTES)  # h11 checks it only while a head is incomplete
        self.refused = 400
        self._chunks = self._bytes = 0

    def next_event(self) -> Any:
        """The next part of a request.

        Raises h11.RemoteProtocolError for a request with too many parts.
        """
        try:
            return self._checked(len(self._receive_buffer))
        except h11.RemoteProtocolError as error:
            self.refused = error.error_status_hint
            raise

    def _checked(self, waiting: int) -> Any:
        event = super().next_event()
        if isinstance(event, h11.Request | h11.EndOfMessage):
            taken = waiting - len(self._receive_buffer)
            if taken > MAX_HEAD_BYTES or len(event.headers) > MAX_HEADERS:
                raise h11.RemoteProtocolError("the headers of the request are too large", TOO_LARGE)
        if isinstance(event, h11.Request):
            self._chunks = self._bytes = 0
            if {b"content-length", b"transfer-encoding"} <= {name for name, _ in event.headers}:
                raise h11.RemoteProtocolError("the request has both Content-Length and Transfer-Encoding")
        elif isinstance(event, h11.Data):
            self._chunks += event.chunk_start
            self._bytes += len(event.data)
            if self._chunks > CHUNKS + self._bytes // CHUNK_BYTES:
                raise h11.RemoteProtocolError("the body of the request has too many chunks")
            if self.our_state is h11.DONE and self._bytes > LATE_BYTES:
                raise h11.RemoteProtocolError("the request has a body that is not expected")
        return event


class Times(NamedTuple):
    """Time limits of a client, in seconds.

    request_s: to send the head of the first request, and of the next one after an answer
    read_s:    to read a full send buffer, before more can be sent
    """

    request_s: float = 10.0
    read_s: float = 30.0


class RequestProtocol(H11Protocol):
    """Ends a connection when its next request is not complete in time, or its client does not read.

    held:  all connections of the server;  times: its time limits
    place: of this connection, once it is admitted
    """

    held = Connections()
    times = Times()
    place: Place | None = None
    _due: asyncio.TimerHandle | None = None
    _unread: asyncio.TimerHandle | None = None
    _reserved = False

    def __init__(self, *values: Any, **named: Any) -> None:
        super().__init__(*values, **named)
        self.conn: Parser = Parser()

    @classmethod
    def of(cls, held: Connections, times: Times) -> type[RequestProtocol]:
        """The protocol of one server."""
        return type(cls.__name__, (cls,), {"held": held, "times": times})

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Wait for the first request, if there is a place."""
        super().connection_made(transport)
        if self.place is None:
            address = self.client[0] if self.client else "local"
            self.place = self.held.admit(transport, address, transport.abort)
        if self.place == "refused":
            transport.abort()
            return
        self._reserved = self.place == "reserved"
        if self._reserved:
            self.app_state: dict[str, Any] = {**self.app_state, "reserved": True}
        self._expect()

    def handle_events(self) -> None:
        """Process received data. The application limits the time for the body of a request."""
        super().handle_events()
        if self.cycle is not None and not self.cycle.response_complete:
            self._forget()
            self.held.works(self.transport)

    def on_response_complete(self) -> None:
        """Wait for the next request; it may have arrived already. Hosts with too many requests are slowed down."""
        self._expect()
        self.held.waits(self.transport)
        pause_s = self.held.pause_s(self.client[0] if self.client else "local")
        if pause_s > 0 and not self.transport.is_closing():
            self.flow.pause_reading()
            self.loop.call_later(pause_s, super().on_response_complete)
        else:
            super().on_response_complete()

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        """The connection becomes a WebSocket, whose protocol reports its end."""
        self._forget()
        self.held.works(self.transport)
        super().handle_websocket_upgrade(event)

    def send_400_response(self, msg: str) -> None:
        """Refuse an invalid or too large request, unless an answer is being sent."""
        if self.conn.our_state not in (h11.IDLE, h11.SEND_RESPONSE):
            self.transport.abort()
            return
        if self.conn.refused == TOO_LARGE:
            status, text = (
                TOO_LARGE,
                f"The head of a request has at most {MAX_HEAD_BYTES // 1024} KiB and {MAX_HEADERS} fields.",
            )
        else:
            status, text = 400, msg
        headers = [
            ("content-type", "text/plain; charset=utf-8"),
            ("connection", "close"),
            ("content-length", str(len(text))),
        ]
        for part in (
            h11.Response(status_code=status, headers=headers, reason=HTTPStatus(status).phrase),
            h11.Data(data=text.encode()),
            h11.EndOfMessage(),
        ):
            self.transport.write(self.conn.send(part))
        self.transport.close()
        if self.cycle is not None:
            self.cycle.disconnected = True  # tells a running application that its client is gone
            self.cycle.message_event.set()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the connection."""
        self._forget()
        self.resume_writing()
        self.held.gone(self.transport)
        super().connection_lost(exc)

    def pause_writing(self) -> None:
        """The send buffer is full: the client has a limited time to read."""
        super().pause_writing()
        if self._unread is None:
            self._unread = self.loop.call_later(self.times.read_s, self._slow)

    def resume_writing(self) -> None:
        """The client reads."""
        if self._unread is not None:
            self._unread.cancel()
            self._unread = None
        super().resume_writing()

    def _expect(self) -> None:
        self._forget()
        wait_s = min(RESERVED_S, self.times.request_s) if self._reserved else self.times.request_s
        self._due = self.loop.call_later(wait_s, self._end)

    def _forget(self) -> None:
        if self._due is not None:
            self._due.cancel()
            self._due = None

    def _end(self) -> None:
        """Close the connection. The client has a limited time to read the rest of the last answer."""
        self.transport.close()
        self._due = self.loop.call_later(self.times.request_s, self.transport.abort)

    def _slow(self) -> None:
        self.held.ended["slow"] += 1
        self.transport.abort()
