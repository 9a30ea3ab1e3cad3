"""Gate: accepts and counts viewers, and forwards bytes between each of them and a server on this machine.

Foxglove's server accepts any number of viewers, and buffers some frames for each. The gate limits their number and ends
viewers that do not read, so that memory is bounded.
"""

from __future__ import annotations

import asyncio
import contextlib
import ipaddress
import logging
import os
import socket
import struct
import threading
from collections import Counter
from collections.abc import Callable
from typing import Final

from lidarcodec.apps.ending import ended
from lidarcodec.errors import TransportError
from lidarcodec.transport.allowance import Allowance

logger = logging.getLogger(__name__)

MAX_VIEWERS: Final = 16
BEGIN_S: Final = 10.0
"""Longest times until a viewer has sent the head of its request, and then until the server has answered."""
LAG_S: Final = 20.0
"""Longest time without reading, while half a megabyte waits here and the system's buffer is full."""
SENDS_AT_ONCE, SENDS_A_SECOND = 2**20, 1024
"""Most bytes that a viewer may send. Requests take a few kB; the server would buffer messages of 64 MB."""
_GONE_S: Final = 40.0
"""Time after which the system ends the connection of a viewer whose machine is gone."""
_NOTHING_MORE: Final = struct.pack("ii", 1, 0)
"""Socket option: discard buffered bytes when the connection is closed."""
END_S: Final = 1.0
"""Time for the last bytes of a connection."""
_TICK_S: Final = 0.2
_QUEUE: Final = 64
_AT_ONCE: Final = 256 * 1024
"""Bytes that are forwarded at once."""
_FROM_SERVER, _TO_VIEWER = 256 * 1024, 1024 * 1024
"""Sizes of the system's buffers. The one from the server is small: the server drops old frames, the system does not."""
_FULL: Final = b"HTTP/1.1 503 Service Unavailable\r\nConnection: close\r\nContent-Length: 0\r\n\r\n"
_FORBIDDEN: Final = b"HTTP/1.1 403 Forbidden\r\nConnection: close\r\nContent-Length: 0\r\n\r\n"
_V6_NETWORK: Final = 64
"""Bits of an IPv6 address that tell one network from another. A host may take any address in its network."""


class _Viewer:
    """A viewer that was let in. waits_since_s: since when bytes wait for it to read them; None if none do"""

    def __init__(self, address: str, task: asyncio.Task[None] | None) -> None:
        self.address, self.task = address, task
        self.waits_since_s: float | None = None


class Gate:
    """Accepts viewers between `open` and `close`, in its own thread.

    port: where it listens, once it does
    counts: `viewers` that were let in, `refused` ones, and those that were `ended`, because they read too slowly, asked
    for nothing or sent too much
    """

    def __init__(
        self,
        host: str,
        port: int,
        most: int = MAX_VIEWERS,
        refusal: Callable[[bytes], str | None] = lambda head: None,
    ) -> None:
        """most: viewers at once; half of them, rounded up, may be of one address

        refusal: why a request with this head is refused; None if it is not
        """
        self.host, self.port, self.most, self._refusal = host, port, most, refusal
        self.counts: Counter[str] = Counter()
        self._listener: socket.socket | None = None
        self._thread: threading.Thread | None = None
        self._stop = threading.Event()
        self._room = most
        self._networks: Counter[str] = Counter()
        self._viewers: list[_Viewer] = []
        self._said: set[str] = set()

    def listen(self) -> None:
        """Take the port; viewers wait until `open`.

        Raises TransportError if nothing can listen there.
        """
        try:
            family, *_, address = socket.getaddrinfo(self.host, self.port, type=socket.SOCK_STREAM)[0]
            self._listener = socket.create_server(address[:2], family=family, backlog=_QUEUE)
        except (OSError, UnicodeError) as error:
            reason = str(error)
            if isinstance(error, socket.gaierror):
                reason = "this host does not exist"
            elif isinstance(error, OSError) and error.errno is not None:
                reason = os.strerror(error.errno)
            raise TransportError(f"cannot listen on {self.host}:{self.port}: {reason}; choose another port") from None
        self.port = self._listener.getsockname()[1]

    def open(self, server: tuple[str, int]) -> None:
        """Accept viewers. server: its address and port"""
        self._thread = threading.Thread(
            target=lambda: asyncio.run(self._serve(server)), name="bridge gate", daemon=True
        )
        self._thread.start()

    def make_room(self, most: int) -> None:
        """Let in at most so many viewers from now on, and end those beyond, first those that do not read."""
        self._room = min(most, self.most)

    def close(self) -> None:
        """Disconnect all viewers and accept no more; harmless when called twice."""
        self._stop.set()
        thread, self._thread = self._thread, None
        if thread is not None:
            ended([thread])
        listener, self._listener = self._listener, None
        if listener is not None:
            listener.close()

    async def _serve(self, server: tuple[str, int]) -> None:
        async def take(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            await self._take(server, reader, writer)

        taking = await asyncio.start_server(take, sock=self._listener, limit=_AT_ONCE, backlog=_QUEUE)
        while not self._stop.is_set():
            await asyncio.sleep(_TICK_S)
            self._end_those_beyond()
        taking.close()  # and the loop ends the tasks of all viewers

    def _end_those_beyond(self) -> None:
        """End viewers while there is no room for all: first the one that does not read for longest, else the last."""
        while len(self._viewers) > self._room:
            waiting = [viewer for viewer in self._viewers if viewer.waits_since_s is not None]
            last = min(waiting, key=lambda one: one.waits_since_s or 0.0) if waiting else self._viewers[-1]
            self._viewers.remove(last)
            self._say("ended", last.address, f"frames are so large that there is memory for {self._room} viewers only")
            if last.task is not None:
                last.task.cancel()

    async def _take(self, server: tuple[str, int], reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve one viewer until it disconnects."""
        address = (writer.get_extra_info("peername") or ("?",))[0]
        network = network_of(address)
        try:
            why = self._full(network)
            if why is not None:
                self._say("refused", address, why)
                writer.write(_FULL)
                await _closed(writer)
                return
            self._networks[network] += 1
            viewer = _Viewer(address, asyncio.current_task())
            self._viewers.append(viewer)
            try:
                head = await _head(reader)
                why = self._refusal(head)
                if why is not None:
                    self._say("refused", address, why)
                    writer.write(_FORBIDDEN)
                    await _closed(writer)
                    return
                self.counts["viewers"] += 1
                await _hand_on(server, reader, writer, viewer, head)
            except _EndError as error:
                self._say("ended", address, str(error))
                writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _NOTHING_MORE)
            finally:
                self._networks[network] -= 1
                if viewer in self._viewers:
                    self._viewers.remove(viewer)
        except (OSError, asyncio.CancelledError):  # it has gone, or the bridge ends; asyncio cannot do with the latter
            pass
        finally:
            writer.transport.abort()

    def _full(self, network: str) -> str | None:
        """Why there is no room for a viewer of a network; None if there is."""
        share = (self._room + 1) // 2
        if self._networks.total() >= self._room:
            return f"{self._room} viewers are connected, which is the limit"
        if self._networks[network] >= share:
            return f"{share} viewers from its address are connected, which is half of the limit"
        return None

    def _say(self, what: str, address: str, why: str) -> None:
        """Count what became of a viewer; log the first one."""
        self.counts[what] += 1
        if what not in self._said:
            self._said.add(what)
            logger.warning("%s a viewer at %s: %s (more are only counted)", what, address, why)


class _EndError(Exception):
    """A viewer has to go."""


async def _head(reader: asyncio.StreamReader) -> bytes:
    """The head of a viewer's request. Raises _EndError."""
    try:
        async with asyncio.timeout(BEGIN_S):
            return await reader.readuntil(b"\r\n\r\n")
    except TimeoutError:
        raise _EndError(f"it sent no request within {BEGIN_S:g} s") from None
    except (asyncio.IncompleteReadError, asyncio.LimitOverrunError):
        raise _EndError("it sent no request of a usual length") from None


async def _hand_on(
    server: tuple[str, int], reader: asyncio.StreamReader, writer: asyncio.StreamWriter, viewer: _Viewer, head: bytes
) -> None:
    """Hand bytes on between a viewer and the server until one of them ends. head: of its request, which was read

    Raises _EndError, OSError.
    """
    outer: socket.socket = writer.get_extra_info("socket")
    outer.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _TO_VIEWER)
    outer.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, round(_GONE_S * 1000))
    inner = socket.socket()
    inner.setblocking(False)
    inner.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _FROM_SERVER)  # connecting tells the server how much
    try:
        await asyncio.wait_for(asyncio.get_running_loop().sock_connect(inner, server), BEGIN_S)
        answers, questions = await asyncio.open_connection(sock=inner, limit=_AT_ONCE)
    except BaseException:
        inner.close()
        raise
    questions.write(head)
    ways = [asyncio.create_task(_ask(reader, questions)), asyncio.create_task(_answer(answers, writer, viewer))]
    try:
        done, _ = await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
        for way in done:
            way.result()
        await _closed(writer)
    finally:
        questions.transport.abort()
        for way in ways:
            way.cancel()
        await asyncio.gather(*ways, return_exceptions=True)


async def _ask(viewer: asyncio.StreamReader, server: asyncio.StreamWriter) -> None:
    """Hand on what a viewer sends, until it ends. Raises _EndError, OSError."""
    allowed = Allowance(SENDS_A_SECOND, SENDS_AT_ONCE)
    while data := await viewer.read(_AT_ONCE):
        if allowed.take(len(data)):
            raise _EndError(f"it sent more than {SENDS_AT_ONCE} bytes at once, or more than {SENDS_A_SECOND} a second")
        await _send(server, data)


async def _answer(server: asyncio.StreamReader, writer: asyncio.StreamWriter, viewer: _Viewer) -> None:
    """Hand on what the server sends, until it ends. Raises _EndError, OSError."""
    try:
        async with asyncio.timeout(BEGIN_S):
            data = await server.read(_AT_ONCE)
    except TimeoutError:
        raise _EndError(f"its request was not answered within {BEGIN_S:g} s") from None
    while data:
        viewer.waits_since_s = asyncio.get_running_loop().time()
        await _send(writer, data)
        viewer.waits_since_s = None
        data = await server.read(_AT_ONCE)


async def _send(to: asyncio.StreamWriter, data: bytes) -> None:
    to.write(data)
    try:
        async with asyncio.timeout(LAG_S):
            await to.drain()
    except TimeoutError:
        raise _EndError(f"it received too slowly for {LAG_S:g} s") from None


async def _closed(writer: asyncio.StreamWriter) -> None:
    """Close a connection once its last bytes are sent, if that does not take long."""
    writer.close()
    with contextlib.suppress(TimeoutError):
        await asyncio.wait_for(writer.wait_closed(), END_S)


def network_of(address: str) -> str:
    """Whose addresses count as one: those of an IPv6 network.

    >>> network_of("10.0.0.1"), network_of("2001:db8::1")
    ('10.0.0.1', '2001:db8::/64')
    """
    try:
        found = ipaddress.ip_address(address.partition("%")[0])
    except ValueError:
        return address
    if found.version == 4:
        return address
    mapped = found.ipv4_mapped
    return str(mapped) if mapped is not None else str(ipaddress.ip_network((found, _V6_NETWORK), strict=False))
