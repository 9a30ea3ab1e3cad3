"""Clients that send as much as they can, and how long a health check takes meanwhile."""

from __future__ import annotations

import contextlib
import http.client
import socket
import threading
import time
from collections.abc import Callable, Iterator

from tests.calm import Calm

MASK = b"\0\0\0\0"


def upgrade(path: str, token: str | None = None) -> bytes:
    """The request that asks for a WebSocket."""
    given = "" if token is None else f"Authorization: Bearer {token}\r\n"
    return (
        f"GET /api/v1/streams/{path} HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        f"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n{given}\r\n"
    ).encode()


def ws_frame(opcode: int, data: bytes = b"", final: bool = True) -> bytes:
    """A frame of a client; its mask changes nothing."""
    return bytes([(0x80 if final else 0) | opcode, 0x80 | len(data)]) + MASK + data


def sending(over: threading.Event, port: int, begin: bytes, blob: bytes, wait: bool = False) -> None:
    """Send `begin`, then `blob` without end, and connect again where the server ends it. wait: for an answer first"""
    while not over.is_set():
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 5) as one:
            one.sendall(begin)
            if wait:
                one.recv(1024)
            while not over.is_set():
                one.sendall(blob)
        time.sleep(0.001)


@contextlib.contextmanager
def flood(count: int, send: Callable[[threading.Event], object]) -> Iterator[None]:
    """So many threads that send until it is over."""
    over = threading.Event()
    threads = [threading.Thread(target=send, args=(over,), daemon=True) for _ in range(count)]
    for one in threads:
        one.start()
    try:
        yield
    finally:
        over.set()
        for one in threads:
            one.join(20)


def longest_answer_s(port: int, for_s: float) -> float:
    """The longest time that a health check took, for so long, without how late the machine was itself."""
    with Calm() as calm:
        longest = _longest_s(port, time.monotonic() + for_s)
    return longest - 20 * calm.late_s


def _longest_s(port: int, until_s: float) -> float:
    longest = 0.0
    while (begin := time.monotonic()) < until_s:
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
        with contextlib.closing(connection):
            connection.request("GET", "/healthz")
            assert connection.getresponse().status == 200
        longest = max(longest, time.monotonic() - begin)
        time.sleep(0.05)
    return longest
