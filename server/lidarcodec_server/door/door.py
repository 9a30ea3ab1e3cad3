"""The door: the first protocol of an accepted connection. It takes a place, and sets up TLS if that is configured.

With TLS a connection counts from its first packet on, and the handshake has a time limit.
"""

from __future__ import annotations

import asyncio
import logging
import ssl
from typing import Any, Final

from lidarcodec_server.door.connections import Connections, Place
from lidarcodec_server.door.request_protocol import RequestProtocol
from lidarcodec_server.limits import SparseLog

logger = logging.getLogger(__name__)

HANDSHAKE_S: Final = 5.0


class Door(asyncio.Protocol):
    """Admits a connection, sets up TLS if that is configured, and passes it to the HTTP protocol.

    held: all connections of the server;  inside: the HTTP protocol;  tls: the TLS context, or None
    """

    held = Connections()
    inside: type[RequestProtocol] = RequestProtocol
    tls: ssl.SSLContext | None = None
    _errors = SparseLog(logger, 60.0)

    @classmethod
    def of(cls, inside: type[RequestProtocol], tls: ssl.SSLContext | None = None) -> type[Door]:
        """The door of one server."""
        return type(cls.__name__, (cls,), {"held": inside.held, "inside": inside, "tls": tls})

    def __init__(self, **named: Any) -> None:
        """named: arguments for the HTTP protocol"""
        self._named = named
        self._transport: asyncio.Transport | None = None
        self._place: Place = "refused"
        self._due: asyncio.TimerHandle | None = None
        self._shaking: asyncio.Task[None] | None = None
        self._early = bytearray()

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Give a connection its place."""
        peer = transport.get_extra_info("peername")
        address = peer[0] if isinstance(peer, tuple) else "local"
        self._transport = transport
        self._named["server_state"].connections.add(self)
        self._place = self.held.admit(transport, address, transport.abort)
        if self._place == "refused":
            transport.abort()
            return
        if self.tls is None:
            self._hand_over(transport)
        else:
            self._due = asyncio.get_running_loop().call_later(HANDSHAKE_S, transport.abort)

    def data_received(self, data: bytes) -> None:
        """The first bytes of a handshake."""
        if self._transport is None or self.tls is None:
            return
        self._early += data
        if self._shaking is None:
            self._shaking = asyncio.get_running_loop().create_task(self._shake_hands(self._transport, self.tls))

    def connection_lost(self, exc: Exception | None) -> None:
        """The connection has ended."""
        self._leave()
        if self._transport is not None:
            self.held.gone(self._transport)  # after the TLS handshake its place has another key

    def shutdown(self) -> None:
        """The server stops."""
        if self._transport is not None:
            self._transport.abort()

    def _hand_over(self, transport: asyncio.Transport, data: bytes = b"") -> None:
        self._leave()
        inside = self.inside(**self._named)
        inside.place = self._place
        transport.set_protocol(inside)
        inside.connection_made(transport)
        if data:
            inside.data_received(data)

    async def _shake_hands(self, plain: asyncio.Transport, tls: ssl.SSLContext) -> None:
        """Encrypt the connection. It keeps its place, under its new name."""
        loop, first = asyncio.get_running_loop(), _First()
        shaking = loop.create_task(
            loop.start_tls(plain, first, tls, server_side=True, ssl_handshake_timeout=HANDSHAKE_S)
        )
        # After the callbacks with which it takes the connection over, and before more is read.
        loop.call_soon(loop.call_soon, self._pass_on, plain)
        try:
            made = await shaking
        except (OSError, ValueError) as error:  # invalid, or not in time
            self._errors.warning("a client failed to set up TLS: %s", str(error) or type(error).__name__)
            made = None
        finally:
            self._leave()
        if made is None or first.lost or not self.held.renamed(plain, made, made.abort):
            self.held.gone(plain)
            plain.abort()
            return
        self._hand_over(made, bytes(first.data))

    def _pass_on(self, plain: asyncio.Transport) -> None:
        """Pass data received before the switch to the TLS protocol."""
        protocol: Any = plain.get_protocol()  # an asyncio.BufferedProtocol; uvloop's is one without the base class
        while self._early and not plain.is_closing():
            buffer = memoryview(protocol.get_buffer(len(self._early)))
            size = min(len(buffer), len(self._early))
            buffer[:size] = self._early[:size]
            del self._early[:size]
            protocol.buffer_updated(size)

    def _leave(self) -> None:
        self._named["server_state"].connections.discard(self)
        if self._due is not None:
            self._due.cancel()
            self._due = None


class _First(asyncio.Protocol):
    """Buffers data that a client sends right after its handshake, until the HTTP protocol takes over."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.lost = False

    def data_received(self, data: bytes) -> None:
        self.data += data

    def connection_lost(self, exc: Exception | None) -> None:
        self.lost = True
