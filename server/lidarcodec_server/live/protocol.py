"""The WebSocket protocol of the server: one that lets no client that reads nothing keep a connection for ever."""

from __future__ import annotations

from typing import Final

from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from lidarcodec_server.connections import Connections

ABORT_S: Final = 5.0
"""What a client has not read so long after its socket ended is thrown away; a reader needs milliseconds."""


class ViewerProtocol(WebSocketsSansIOProtocol):
    """Ends a connection for good soon after the application has left it.

    Otherwise what was sent last waits in memory for as long as the client keeps its end open and does not read.
    held: all connections of the server
    """

    held = Connections()

    @classmethod
    def of(cls, held: Connections) -> type[ViewerProtocol]:
        """The protocol of one server."""
        return type(cls.__name__, (cls,), {"held": held})

    async def run_asgi(self) -> None:
        """Run the application, then give the client a while to read what is left."""
        try:
            await super().run_asgi()
        finally:
            self.loop.call_later(ABORT_S, self.transport.abort)

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the connection."""
        self.held.gone(self.transport)
        super().connection_lost(exc)
