"""The WebSocket protocol of the server: no client keeps it busy, or keeps a connection for ever.

Nothing is read from a client before the application has accepted its socket. After that its frames of every kind are
counted before they are parsed, a few in each turn of the event loop. A client that sends too many is read from more
slowly; if it goes on, it is sent away.
"""

from __future__ import annotations

import asyncio
from typing import Any, Final

from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from lidarcodec_server.door.connections import Connections
from lidarcodec_server.limits import Meter
from lidarcodec_server.live.incoming import Frames

ABORT_S: Final = 5.0
"""What a client has not read so long after its socket ended is thrown away; a reader needs milliseconds."""
FRAME_RATE: Final = 200
FRAME_BURST: Final = 100
"""Frames a second that a client may send, and how many of them at once; a viewer sends one for each frame it got."""
PATIENCE_S: Final = 2.0
"""How long a client may go on sending more than that; meanwhile it is read from at that rate."""
FRAMES_A_TURN: Final = 16
"""Frames of one client that are parsed before others have their turn: 0.3 ms."""
PARTS: Final = 64
"""Parts that a message may have."""
DRAIN_S: Final = 1.0
DRAIN_BYTES: Final = 2**20
"""How long, and how much, is still read and thrown away of a client that is sent away. Closed at once, the connection
would be reset, and the client would not see why."""
POLICY: Final = 1008
_REASON: Final = b"this request opens no WebSocket: it has a body, or a line of more than 8 KiB"
_BODY: Final = b'{"type": "about:blank", "title": "Bad Request", "status": 400, "detail": "%s"}' % _REASON
MALFORMED: Final = (
    b"HTTP/1.1 400 Bad Request\r\nContent-Type: application/problem+json\r\nConnection: close\r\n"
    b"Content-Length: %d\r\n\r\n%s" % (len(_BODY), _BODY)
)
"""The answer to what HTTP takes for a request and the WebSocket parser does not."""


class ViewerProtocol(WebSocketsSansIOProtocol):
    """Counts what clients send, and ends a connection for good soon after the application has left it.

    Otherwise what was sent last waits in memory for as long as the client keeps its end open and does not read.
    held: all connections of the server
    """

    held = Connections()

    def __init__(self, *values: Any, **named: Any) -> None:
        super().__init__(*values, **named)
        self.read_paused = True  # so that the parent leaves reading to this class
        self._incoming = Frames()
        self._meter = Meter(FRAME_RATE, FRAME_BURST, self.loop.time())
        self._later: asyncio.Handle | None = None
        self._too_many_since_s: float | None = None
        self._parts = self._thrown_away = 0
        self._sent_away = False

    @classmethod
    def of(cls, held: Connections) -> type[ViewerProtocol]:
        """The protocol of one server."""
        return type(cls.__name__, (cls,), {"held": held})

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Read nothing until the application has accepted: before that a client has nothing to say."""
        super().connection_made(transport)
        self.transport.pause_reading()

    def data_received(self, data: bytes) -> None:
        """Take the request, which the HTTP protocol hands over; later what the client sends."""
        if not self.handshake_initiated:
            super().data_received(data)
            if not self.handshake_initiated:
                self._refuse_request()
        elif self._sent_away:
            self._thrown_away += len(data)
            if self._thrown_away > DRAIN_BYTES:
                self.transport.abort()
        else:
            self._incoming.feed(data)
            self._go_on()

    async def receive(self) -> Any:
        """The next message for the application."""
        message = await self.queue.get()
        self._go_on()
        return message

    async def send(self, message: Any) -> None:
        """Send what the application says; from its `accept` on the client is read from."""
        await super().send(message)
        self._go_on()

    def resume_writing(self) -> None:
        """The client reads, so it may also be answered."""
        super().resume_writing()
        self._go_on()

    def keepalive_timeout(self) -> None:
        """The client has not answered a ping, so it may not read either: it gets no time for that."""
        super().keepalive_timeout()
        self.loop.call_later(ABORT_S, self.transport.abort)

    async def run_asgi(self) -> None:
        """Run the application, then give the client a while to read what is left."""
        try:
            await super().run_asgi()
        finally:
            self.loop.call_later(ABORT_S, self.transport.abort)

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the connection."""
        self._wait_no_more()
        self._incoming.clear()
        self.held.gone(self.transport)
        super().connection_lost(exc)

    def _refuse_request(self) -> None:
        """Answer and close. Nothing is read from such a client, so nobody would notice that it has gone."""
        self.handshake_initiated = self._sent_away = self.close_sent = True
        self.transport.write(MALFORMED)
        self.transport.close()
        self.loop.call_later(ABORT_S, self.transport.abort)

    # --- frames -----------------------------------------------------------------------------------------------------

    def _go_on(self) -> None:
        """Parse as much as is allowed now. The client is read from only while nothing of it is left."""
        if self._sent_away or not self.handshake_complete or self.transport.is_closing():
            return
        self._wait_no_more()
        for _ in range(FRAMES_A_TURN):
            if not self._taken() or not self.writable.is_set():  # a pong is an answer that has to be read
                self.transport.pause_reading()
                return
            wait_s = self._meter.wait_s(self.loop.time())
            if wait_s > 0:
                self._slow_down(wait_s)
                return
            piece = self._incoming.take()
            if piece is None:
                self._too_many_since_s = None
                self.transport.resume_reading()
                return
            self._meter.spend(piece.cost, self.loop.time())
            if piece.cost:
                self._parts = self._parts + 1 if piece.part else 0
            if self._parts > PARTS:
                self._send_away(f"a message has at most {PARTS} parts")
                return
            super().data_received(piece.data)
            if self.transport.is_closing():
                return
        self.transport.pause_reading()
        self._later = self.loop.call_soon(self._go_on)

    def _taken(self) -> bool:
        """Whether the application has taken all messages; those behind its `close` are for nobody."""
        return self.close_sent or self.queue.empty()

    def _slow_down(self, wait_s: float) -> None:
        self.transport.pause_reading()
        now_s = self.loop.time()
        if self._too_many_since_s is None:
            self._too_many_since_s = now_s
        if now_s - self._too_many_since_s > PATIENCE_S:
            self._send_away(f"more than {FRAME_RATE} frames a second")
        else:
            self._later = self.loop.call_later(max(wait_s, FRAMES_A_TURN / FRAME_RATE), self._go_on)

    def _send_away(self, reason: str) -> None:
        """Close with a reason, say so once, and throw away what still comes."""
        self._sent_away = True
        self._incoming.clear()
        self.held.end("flood", self.client[0] if self.client else "local", reason)
        if self.close_sent:
            self.transport.abort()
            return
        gone: Any = {"type": "websocket.disconnect", "code": POLICY, "reason": reason, "flood": True}
        self.queue.put_nowait(gone)
        self.stop_keepalive()
        self.conn.send_close(POLICY, reason)
        self.transport.write(b"".join(self.conn.data_to_send()))
        self.close_sent = self.disconnected = True
        self.transport.resume_reading()
        self.close_timer = self.loop.call_later(DRAIN_S, self.transport.close)

    def _wait_no_more(self) -> None:
        if self._later is not None:
            self._later.cancel()
            self._later = None
