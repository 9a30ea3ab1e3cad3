"""The WebSocket protocol of the server: it limits the work that a client can cause, and the life of its connection.

Nothing is read from a client before the application has accepted its socket. After that all its frames are counted
before they are parsed, a few in each turn of the event loop. If a client sends too many, the server reads from it more
slowly; if it continues, the server disconnects it.
"""

from __future__ import annotations

import asyncio
from typing import Any, Final

from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from lidarcodec_server.door.connections import Connections
from lidarcodec_server.limits import Meter
from lidarcodec_server.live.incoming import Frames

ABORT_S: Final = 5.0
"""After the end of a socket its client has so long to read the rest; then it is discarded."""
FRAME_RATE: Final = 200
FRAME_BURST: Final = 100
"""Frames that a client may send in a second, and at once. A viewer sends one for each frame that it got."""
PATIENCE_S: Final = 2.0
"""How long a client may exceed that rate; meanwhile the server reads from it at that rate."""
FRAMES_A_TURN: Final = 16
"""Frames of one client that are parsed before other clients have their turn."""
PARTS: Final = 64
"""Most fragments of a message."""
DRAIN_S: Final = 1.0
DRAIN_BYTES: Final = 2**20
"""How long, and how many bytes, the server still reads and discards from a disconnected client. If it closed at once,
the connection would be reset, and the client would not see the reason."""
POLICY: Final = 1008
_REASON: Final = b"this request opens no WebSocket: it has a body, or a line of more than 8 KiB"
_BODY: Final = b'{"type": "about:blank", "title": "Bad Request", "status": 400, "detail": "%s"}' % _REASON
MALFORMED: Final = (
    b"HTTP/1.1 400 Bad Request\r\nContent-Type: application/problem+json\r\nConnection: close\r\n"
    b"Content-Length: %d\r\n\r\n%s" % (len(_BODY), _BODY)
)
"""The answer to a request that the HTTP parser accepts and the WebSocket parser refuses."""


class ViewerProtocol(WebSocketsSansIOProtocol):
    """Counts the frames of a client, and closes a connection soon after the application has ended.

    Otherwise unsent data would stay in memory as long as the client keeps its end open and does not read.
    held: all connections of the server
    """

    held = Connections()

    def __init__(self, *values: Any, **named: Any) -> None:
        super().__init__(*values, **named)
        self.read_paused = True  # so that the parent class leaves reading to this class
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
        """Read nothing until the application has accepted the socket."""
        super().connection_made(transport)
        self.transport.pause_reading()

    def data_received(self, data: bytes) -> None:
        """Receive the request from the HTTP protocol; later the client's data."""
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
        """Send the application's message. Begin to read from the client after `accept`."""
        await super().send(message)
        self._go_on()

    def resume_writing(self) -> None:
        """The client reads, so it can also be answered."""
        super().resume_writing()
        self._go_on()

    def keepalive_timeout(self) -> None:
        """The client did not answer a ping, so it probably does not read: close at once."""
        super().keepalive_timeout()
        self.loop.call_later(ABORT_S, self.transport.abort)

    async def run_asgi(self) -> None:
        """Run the application, then give the client time to read the rest."""
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
        """Answer and close. The server does not read from such a client, so it would not notice its end."""
        self.handshake_initiated = self._sent_away = self.close_sent = True
        self.transport.write(MALFORMED)
        self.transport.close()
        self.loop.call_later(ABORT_S, self.transport.abort)

    # --- frames -----------------------------------------------------------------------------------------------------

    def _go_on(self) -> None:
        """Parse as much as is allowed now. Read more from the client only when nothing is left to parse."""
        if self._sent_away or not self.handshake_complete or self.transport.is_closing():
            return
        self._wait_no_more()
        for _ in range(FRAMES_A_TURN):
            if not self._taken() or not self.writable.is_set():  # a pong is an answer that the client must read
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
                self._send_away(f"a message has at most {PARTS} fragments")
                return
            super().data_received(piece.data)
            if self.transport.is_closing():
                return
        self.transport.pause_reading()
        self._later = self.loop.call_soon(self._go_on)

    def _taken(self) -> bool:
        """Whether the application has received all messages. Messages after its `close` do not count."""
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
        """Close with a reason, log it once, and discard further data."""
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
