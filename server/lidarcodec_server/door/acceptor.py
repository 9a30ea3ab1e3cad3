"""The acceptor: accepts connections from the system's queue faster than clients can make them.

The connections of a host have a rate limit. Above it the request is examined before a protocol object is made: a client
with a valid token gets in, `/healthz` is answered at once, and all others get a fixed answer, or none if there are too
many of them. That is far cheaper than refusing a request in HTTP, and it keeps the system's queue short. Otherwise a
client that connects again and again would fill that queue and delay all other clients.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import re
import socket
import time
from collections.abc import Callable
from typing import Final

from lidarcodec_server.auth import TOKEN_PROTOCOL
from lidarcodec_server.door.connections import Connections
from lidarcodec_server.limits import SparseLog

logger = logging.getLogger(__name__)

A_TURN, TURN_S = 512, 0.01
"""Most connections accepted in one turn of the event loop, and the longest time for that."""
QUEUE = 256
"""Length of the system's queue. A client that connects very often would fill a long queue and delay all others. If a
short queue is full, the client's system tries again by itself."""
LOOK_S, PATIENCE_S, WAITING = 0.01, 2.0, 64
"""Connections that have not sent anything yet: interval of checks, longest wait, and largest number."""
PAUSE_S = 0.5
"""Pause when there are no file handles left."""
LOOKED_AT: Final = 8192
"""Bytes of a request that are examined; its head has at most 16 KiB."""
_WELL: Final = b"GET /healthz "
WELL: Final = (
    b"HTTP/1.1 200 OK\r\nContent-Type: application/json\r\nX-Content-Type-Options: nosniff\r\n"
    b'Connection: close\r\nContent-Length: 11\r\n\r\n{"ok":true}'
)
_HANDSHAKE, _RECORD = 0x16, 5
"""RFC 8446, 5.1: the type of a record that begins a handshake, and the size of its head in bytes. The last two of
them are the length."""
_READY: Final = b"GET /readyz "
_TOKEN: Final = re.compile(
    rb"\r\n(?:authorization: *bearer +|sec-websocket-protocol:[^\r]*?" + re.escape(TOKEN_PROTOCOL).encode() + rb")"
    rb"([^\s,]{1,128})",
    re.IGNORECASE,
)
_WHY: Final = b"this host connects too often: keep connections open, or try again"
_BODY: Final = (
    b'{"type": "urn:lidarcodec:problem:too-many", "title": "Too Many Requests", "status": 429, "detail": "%s"}' % _WHY
)
TOO_MANY: Final = (
    b"HTTP/1.1 429 Too Many Requests\r\nContent-Type: application/problem+json\r\nRetry-After: 1\r\n"
    b"Connection: close\r\nContent-Length: %d\r\n\r\n%s" % (len(_BODY), _BODY)
)


class Acceptor:
    """Takes the connections of a listening socket. Belongs to the event loop."""

    def __init__(
        self,
        listener: socket.socket,
        protocol: Callable[[], asyncio.BaseProtocol],
        held: Connections,
        owner: Callable[[str], str | None],
        *,
        encrypted: bool,
    ) -> None:
        """protocol: makes the protocol of an accepted connection
        owner: gives the name of a token if it is known to be valid, without reading the store
        encrypted: requests cannot be read yet, and a refused client gets no answer
        """
        self._listener, self._protocol, self._held, self._owner = listener, protocol, held, owner
        self._encrypted = encrypted
        self._loop = asyncio.get_running_loop()
        self._waiting: dict[socket.socket, tuple[str, float]] = {}
        self._timer: asyncio.TimerHandle | None = None
        self._tasks: set[asyncio.Task[object]] = set()
        self._read = bytearray(65536)
        self._warnings = SparseLog(logger, 10.0)
        self._closed = False
        listener.setblocking(False)
        listener.listen(QUEUE)
        self._loop.add_reader(listener.fileno(), self._accept)

    def close(self) -> None:
        """Accept no more connections. The caller closes the listening socket."""
        self._closed = True
        self._loop.remove_reader(self._listener.fileno())
        if self._timer is not None:
            self._timer.cancel()
        for one in self._waiting:
            one.close()
        self._waiting.clear()

    def _accept(self) -> None:
        end_s = time.monotonic() + TURN_S
        for _ in range(A_TURN):
            try:
                one, address = self._listener.accept()
            except (BlockingIOError, InterruptedError, ConnectionAbortedError):
                return
            except OSError as error:
                self._warnings.warning("cannot accept connections: %s", error)
                self._loop.remove_reader(self._listener.fileno())
                self._loop.call_later(PAUSE_S, self._again)
                return
            one.setblocking(False)
            if self._held.hasty(address[0]):
                self._look(one, address[0])
            else:
                self._let_in(one)
            if time.monotonic() > end_s:
                return

    def _again(self) -> None:
        if not self._closed:
            self._loop.add_reader(self._listener.fileno(), self._accept)

    def _let_in(self, one: socket.socket) -> None:
        one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        task = self._loop.create_task(self._connect(one))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _connect(self, one: socket.socket) -> None:
        try:
            await self._loop.connect_accepted_socket(self._protocol, one)
        except OSError:  # closed meanwhile
            one.close()

    # --- connections beyond the rate --------------------------------------------------------------------------------

    def _look(self, one: socket.socket, host: str) -> None:
        if not self._decide(one, host):
            if len(self._waiting) >= WAITING:
                oldest = next(iter(self._waiting))
                self._turn_away(oldest, self._waiting.pop(oldest)[0])
            self._waiting[one] = host, time.monotonic() + PATIENCE_S
            if self._timer is None:
                self._timer = self._loop.call_later(LOOK_S, self._look_again)

    def _look_again(self) -> None:
        now_s = time.monotonic()
        for one, (host, until_s) in list(self._waiting.items()):
            if self._decide(one, host):
                del self._waiting[one]
            elif now_s >= until_s:
                del self._waiting[one]
                self._turn_away(one, host)
        self._timer = self._loop.call_later(LOOK_S, self._look_again) if self._waiting else None

    def _decide(self, one: socket.socket, host: str) -> bool:
        """Accept, answer or refuse a client by its request. False while the request is incomplete."""
        try:
            data = one.recv(LOOKED_AT, socket.MSG_PEEK)
        except BlockingIOError:
            return False
        except OSError:
            data = b""
        if self._encrypted and data:
            return self._decide_handshake(one, host, data)
        found = _TOKEN.search(data)
        whole = not data or b"\r\n\r\n" in data or len(data) == LOOKED_AT
        if data.startswith(_WELL):
            self._answer(one, WELL)
        elif found is None and not whole:
            return False
        elif self._may_enter(data, host, found):
            self._let_in(one)
        else:
            self._turn_away(one, host)
        return True

    def _decide_handshake(self, one: socket.socket, host: str, data: bytes) -> bool:
        """The same with TLS, where requests cannot be read yet: handshakes have a rate limit of their own."""
        if len(data) < _RECORD or len(data) < min(LOOKED_AT, _RECORD + int.from_bytes(data[3:_RECORD], "big")):
            return False
        if data[0] == _HANDSHAKE and not self._held.hasty_client(f"of handshakes, on {host}"):
            self._let_in(one)
        else:
            self._turn_away(one, host)
        return True

    def _may_enter(self, data: bytes, host: str, found: re.Match[bytes] | None) -> bool:
        """Whether a client has a valid token or asks for `/readyz`, and does so within its rate limit."""
        if data.startswith(_READY):
            return not self._held.hasty_client(f"of readiness checks, on {host}")
        return found is not None and not self._held.hasty_client(self._owner(found[1].decode("latin-1")) or "")

    def _turn_away(self, one: socket.socket, host: str) -> None:
        self._held.end("hasty", host, "it connects too often")
        explained = not self._encrypted and not self._held.hasty_client(f"of refusals with an answer, on {host}")
        self._answer(one, TOO_MANY if explained else b"")

    def _answer(self, one: socket.socket, answer: bytes) -> None:
        """Answer, if there is an answer, and close."""
        if answer:
            with contextlib.suppress(OSError):  # closing with unread data would reset it and lose the answer
                one.recv_into(self._read)
            with contextlib.suppress(OSError):
                one.send(answer)
        one.close()
