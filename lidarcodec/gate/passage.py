"""Passage: one connection from its first byte to its last, through two sockets that never block."""

from __future__ import annotations

import contextlib
import selectors
import socket
import struct
from collections.abc import Callable
from enum import Enum
from typing import Final

from lidarcodec.gate.addresses import Address
from lidarcodec.gate.records import NotTlsError, Progress, whole_hello

CHUNK: Final = 65536
"""Bytes that one direction holds at most; no more is read until they are sent."""
CHUNKS: Final = 8
"""Chunks that one direction moves before others have their turn."""
KEPT_BYTES: Final = 65536
"""Buffer of the socket towards Zenoh, so that frames wait with the sender, where a newer one replaces them."""
_AT_ONCE: Final = struct.pack("ii", 1, 0)
READ, WRITE = selectors.EVENT_READ, selectors.EVENT_WRITE


class Stage(Enum):
    """How far a connection is."""

    HELLO = "hello"
    WAITING = "waiting"
    SHAKING = "shaking"
    OPEN = "open"
    CLOSED = "closed"


class Way:
    """One direction: what was read and is not sent yet, and whether the sender has ended."""

    def __init__(self, reader: socket.socket, writer: socket.socket) -> None:
        self.reader, self.writer = reader, writer
        self.held = memoryview(b"")
        self.ended = self.shut = False


class Passage:
    """A connection of one address. `changed` is called with a cause when it must be closed, and with None when it made
    progress."""

    def __init__(
        self,
        selector: selectors.BaseSelector,
        client: socket.socket,
        address: Address,
        port: int,
        now_s: float,
        changed: Callable[[Passage, str | None], None],
    ) -> None:
        self.address, self.port, self.begun_s, self.stage = address, port, now_s, Stage.HELLO
        self.hello_s = now_s
        """When its ClientHello was whole, then when it went on to Zenoh."""
        self.ended_s: float | None = None
        self.sent_away = False
        """Whether Zenoh has closed before the client."""
        self.counts_as_failing = False
        self.known = False
        self.opened_s: float | None = None
        """When it seemed to have a session, until that is sure."""
        self.progress: Progress | None = Progress()
        self.to_zenoh = self.to_client = 0
        self._selector, self._client, self._changed = selector, client, changed
        self._inner: socket.socket | None = None
        self._broken: socket.socket | None = None
        """The one of the two that broke."""
        self._ways: tuple[Way, ...] = ()
        self._hello = bytearray()
        self._moved, self._moved_s = 0, now_s
        selector.register(client, READ, self._read_hello)

    @property
    def ending(self) -> bool:
        """Whether one end has closed."""
        return any(way.ended for way in self._ways)

    @property
    def left(self) -> bool:
        """Whether the client has closed."""
        return bool(self._ways) and self._ways[0].ended

    def stuck_for(self, now_s: float) -> float:
        """Seconds since bytes that are held have not moved, as far as calls of this function can tell."""
        moved = self.to_zenoh + self.to_client
        if moved != self._moved or not any(way.held for way in self._ways):
            self._moved, self._moved_s = moved, now_s
        return now_s - self._moved_s

    def connect(self, now_s: float) -> None:
        """Go on to Zenoh."""
        self.stage, self.hello_s = Stage.SHAKING, now_s
        inner = self._inner = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        inner.setblocking(False)
        inner.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, KEPT_BYTES)
        for one in (inner, self._client):
            one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._client.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        if hasattr(socket, "TCP_NOTSENT_LOWAT"):
            self._client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, KEPT_BYTES)
        to_zenoh, to_client = Way(self._client, inner), Way(inner, self._client)
        to_zenoh.held = memoryview(bytes(self._hello))
        self._ways = to_zenoh, to_client
        with contextlib.suppress(BlockingIOError):
            inner.connect(("127.0.0.1", self.port))
        self._selector.unregister(self._client)
        self._selector.register(inner, WRITE, self._connected)

    def close(self, *, reset: bool = False) -> None:
        """End both sockets; harmless when called twice. reset: at once, nothing of it stays with the system"""
        self.stage = Stage.CLOSED
        for one in (self._client, self._inner):
            if one is not None:
                with contextlib.suppress(KeyError, ValueError):
                    self._selector.unregister(one)
                if reset:
                    with contextlib.suppress(OSError):
                        one.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _AT_ONCE)
                one.close()

    def _read_hello(self, _: int) -> None:
        try:
            data = self._client.recv(CHUNK - len(self._hello))
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            return self._changed(self, "left")
        self._hello += data
        try:
            whole = whole_hello(self._hello)
        except NotTlsError:
            return self._changed(self, "not_tls")
        if whole:
            self.stage = Stage.WAITING
            self._selector.modify(self._client, READ, self._read_waiting)
            self._changed(self, None)
        return None

    def _read_waiting(self, _: int) -> None:
        """A client says nothing more before it has an answer."""
        try:
            data = self._client.recv(1)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        self._changed(self, "not_tls" if data else "left")

    def _connected(self, _: int) -> None:
        assert self._inner is not None
        if self._inner.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
            return self._changed(self, "unreachable")
        self._selector.modify(self._inner, READ, self._pass_on)
        self._selector.register(self._client, READ, self._pass_on)
        assert self.progress is not None
        self.progress.from_client(self._ways[0].held)
        return self._pass_on(0)

    def _pass_on(self, _: int) -> None:
        """Move what can be moved, both ways; then wait for what cannot."""
        try:
            for way in self._ways:
                for _ in range(CHUNKS):
                    if not self._move(way):
                        break
        except NotTlsError:
            return self._changed(self, "not_tls")
        except OSError:
            self.sent_away = self._broken is self._inner and not self.left
            return self._changed(self, "broken")
        if all(way.shut for way in self._ways):
            return self._changed(self, "ended")
        if self.progress is not None or self.ending:
            self._changed(self, None)
        if self.stage is not Stage.CLOSED:
            self._wait()
        return None

    def _move(self, way: Way) -> bool:
        """Read what there is and send it; whether there may be more to move."""
        if not way.held and not way.ended:
            try:
                data = way.reader.recv(CHUNK)
            except BlockingIOError:
                return False
            except OSError:
                self._broken = way.reader
                raise
            way.ended = not data
            way.held = memoryview(data)
            self._watch(way, way.held)
        if way.held:
            with contextlib.suppress(BlockingIOError):
                sent = way.writer.send(way.held)
                way.held = way.held[sent:]
                if way is self._ways[0]:
                    self.to_zenoh += sent
                else:
                    self.to_client += sent
        if way.ended and not way.held and not way.shut:
            way.shut = True
            with contextlib.suppress(OSError):
                way.writer.shutdown(socket.SHUT_WR)
        return not way.held and not way.ended

    def _watch(self, way: Way, data: memoryview) -> None:
        if self.progress is None:
            return
        if way is self._ways[0]:
            self.progress.from_client(data)
        else:
            self.progress.from_server(data)

    def _wait(self) -> None:
        """Read where nothing is held, write where something is."""
        wanted: dict[socket.socket, int] = {way.reader: 0 for way in self._ways}
        for way in self._ways:
            if way.held:
                wanted[way.writer] |= WRITE
            elif not way.ended:
                wanted[way.reader] |= READ
        for one, events in wanted.items():
            known = self._selector.get_map().get(one)
            if known is None and events:
                self._selector.register(one, events, self._pass_on)
            elif known is not None and not events:
                self._selector.unregister(one)
            elif known is not None and known.events != events:
                self._selector.modify(one, events, self._pass_on)
