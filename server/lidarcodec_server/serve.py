"""serve: runs the application on a socket until SIGINT or SIGTERM.

It is one process: the service owns the network session and the decoders. The caller configures logging.
"""

from __future__ import annotations

import asyncio
import json
import logging
import os
import resource
import socket
from collections.abc import Callable
from typing import Any

import uvicorn

from lidarcodec.apps.notify import AGAIN_S, Manager
from lidarcodec.errors import SettingsError, TransportError
from lidarcodec_server.app import create_app
from lidarcodec_server.config import ServerConfig
from lidarcodec_server.door.acceptor import Acceptor
from lidarcodec_server.door.door import Door
from lidarcodec_server.door.listening import address_of, begin, tls_of
from lidarcodec_server.door.own_certificate import OwnCertificate
from lidarcodec_server.door.request_protocol import RequestProtocol, Times
from lidarcodec_server.live.protocol import ViewerProtocol
from lidarcodec_server.store.store import Store
from lidarcodec_server.tokens import TokenBook

logger = logging.getLogger(__name__)

WAITING_MESSAGES = 8
"""Most WebSocket messages of one client that wait for the application; with more the server stops reading."""
OTHER_FILES = 256
"""Open files besides connections of clients: network, database, recordings."""
LINGER_S = 2
"""Longest wait for open connections when the server stops."""


class Listening(uvicorn.Server):
    """A uvicorn server with our own acceptor of connections."""

    def __init__(
        self, config: uvicorn.Config, accept: Callable[[Callable[[], asyncio.Protocol]], Acceptor], ready: str
    ) -> None:
        """accept: begins to accept connections; its argument makes the protocol of each connection
        ready: line printed once everything is open, so that a program that waits for it can rely on the server
        """
        super().__init__(config)
        self._accept, self._ready = accept, ready
        self._acceptor: Acceptor | None = None
        self._manager = Manager.of(os.environ)
        self._manager.wait_s = 0.0  # it is told from the event loop
        self._told_ready = False
        self._telling: asyncio.TimerHandle | None = None

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start everything, then accept connections."""
        await super().startup(sockets=sockets)
        if not self.started:
            return
        self._acceptor = self._accept(self._protocol)
        print(self._ready, flush=True)
        self._tell_manager()

    def _tell_manager(self) -> None:
        """Tell the service manager that the server is ready, and then that it is alive, from the event loop: while the
        loop is blocked, the manager hears nothing. What it did not get is sent again soon."""
        if not self._told_ready:
            self._told_ready = heard = self._manager.ready("serving")
        else:
            heard = self._manager.alive()
        next_s = self._manager.every_s if heard else AGAIN_S
        if next_s is not None:
            self._telling = asyncio.get_running_loop().call_later(next_s, self._tell_manager)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Stop accepting connections, and end."""
        if self._telling is not None:
            self._telling.cancel()
        self._manager.stopping()
        if self._acceptor is not None:
            self._acceptor.close()
        await super().shutdown(sockets=sockets)

    def _protocol(self) -> asyncio.Protocol:
        make: Any = self.config.http_protocol_class
        made: asyncio.Protocol = make(
            config=self.config, server_state=self.server_state, app_state=self.lifespan.state, _loop=None
        )
        return made


def run(config: ServerConfig, listener: socket.socket | None = None, *, as_json: bool = False) -> None:
    """Serve until a signal arrives. listener: from `listening.begin`, for a server that only this machine can reach

    Raises SettingsError if other machines can reach a server that needs no token; TransportError or StoreError if the
    address, the network or the database cannot be used.
    """
    if listener is None:
        check_open(config)
        listener = begin(config)
    app = create_app(with_handles(config))
    held, tokens = app.state.connections, app.state.service.tokens
    inside = RequestProtocol.of(held, Times(config.request_s, config.read_s))
    tls = tls_of(config)
    door = Door.of(inside, tls)
    address = address_of(listener, config)
    own = OwnCertificate(config, lambda renewed: setattr(door, "tls", renewed))
    server = Listening(
        uvicorn.Config(
            app,
            http=door,
            ws=ViewerProtocol.of(held),
            ws_per_message_deflate=False,  # the data is already compressed
            ws_max_size=config.max_message_bytes,
            ws_max_queue=WAITING_MESSAGES,
            timeout_keep_alive=config.keep_alive_s,  # type: ignore[arg-type] # (any number of seconds will do)
            timeout_graceful_shutdown=LINGER_S,
            lifespan="on",
            log_config=None,
            log_level="critical",  # our own code logs each error once
            access_log=False,
            server_header=False,
            proxy_headers=False,
        ),
        lambda protocol: Acceptor(listener, protocol, held, tokens.owner, encrypted=tls is not None),
        json.dumps({"address": address}) if as_json else f"Serving on {address} until you press Ctrl-C",
    )
    own.start()
    try:
        server.run(sockets=[])
    except SystemExit:  # uvicorn's way to report that it could not start
        raise app.state.failure or TransportError("the server could not start") from None
    finally:
        own.close()
        listener.close()
    if app.state.failure is not None:
        raise app.state.failure


def with_handles(config: ServerConfig) -> ServerConfig:
    """Raise the limit of open files as far as allowed. Returns the configuration with as many connections as fit."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft != hard:
        try:
            resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
            soft = hard
        except (ValueError, OSError) as error:
            logger.warning("the limit of %d open files cannot be raised: %s", soft, error)
    room = max(1, soft - OTHER_FILES - config.reserved_connections)
    if soft == resource.RLIM_INFINITY or config.max_connections <= room:
        return config
    logger.warning(
        "this process may open %d files, so it accepts only %d connections instead of %d",
        soft,
        room,
        config.max_connections,
    )
    return config.model_copy(update={"max_connections": room})


def check_open(config: ServerConfig) -> None:
    """Check that strangers cannot change the fleet.

    Raises SettingsError if other machines can reach a server that needs no token.
    """
    if config.loopback:
        return
    store = Store(config.database_url)
    try:
        store.open()
        protected = TokenBook(store, opened=config.open).needed
    finally:
        store.close()
    if not protected and not config.insecure:
        raise SettingsError(
            f"anybody could change the streams on {config.host}, because there is no token yet: create one with "
            "`lidarcodec token create NAME --role operator`, or use --insecure",
            "host",
        )
    if not protected:
        logger.warning("--insecure: anybody who reaches %s can watch and change everything", config.host)
    elif config.tls_certificate is None:
        logger.warning("tokens are sent unencrypted to %s: use --tls-certificate, or a proxy with TLS", config.host)
