"""A TCP relay that is as slow as a mobile network: a rate and a delay each way, and little room for what waits.

It back-pressures: what cannot leave stays in the sender's own buffers, as behind a modem with a small queue.
"""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections import deque


class Relay:
    """Listens on a loopback port and relays to another: `kbit` a second back from the target, `delay_s` each way.

    kbit: may be changed while it runs; with 0 nothing goes through in that direction
    carried: bytes that came back from the target
    """

    BUFFER = 32 * 1024
    PIECE = 4096
    LATE_S = 0.01
    """A thread that is woken late on a busy machine may make up for so much; else the path were slower than said."""

    def __init__(self, target_port: int, *, kbit: float, delay_s: float = 0.0) -> None:
        self._target, self.kbit, self._delay_s = ("127.0.0.1", target_port), kbit, delay_s
        self.closed = False
        self.carried = 0
        self._listener = socket.socket()
        self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, self.BUFFER)
        self._listener.bind(("127.0.0.1", 0))
        self._listener.listen()
        self.port = self._listener.getsockname()[1]
        self._sockets: list[socket.socket] = [self._listener]
        self._threads = [threading.Thread(target=self._accept, daemon=True)]
        self._threads[0].start()

    def close(self) -> None:
        self.closed = True
        for one in self._sockets:
            with contextlib.suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)
            one.close()
        for thread in self._threads:
            thread.join(2)

    def cut(self) -> None:
        """End all connections. New ones are taken."""
        for one in self._sockets[1:]:
            with contextlib.suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)

    def _accept(self) -> None:
        while True:
            try:
                near, _ = self._listener.accept()
            except OSError:
                return
            far = socket.socket()
            far.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, self.BUFFER)
            try:
                far.connect(self._target)
            except OSError:
                near.close()
                far.close()
                continue
            self._sockets += [near, far]
            for one in (near, far):
                one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            for source, sink, relay in ((near, far, None), (far, near, self)):
                line = _Line(source, sink, relay, self._delay_s)
                self._threads += line.threads


class _Line:
    """One direction: a thread that takes at the rate, one that gives after the delay."""

    def __init__(self, source: socket.socket, sink: socket.socket, relay: Relay | None, delay_s: float) -> None:
        self._source, self._sink, self._relay, self._delay_s = source, sink, relay, delay_s
        self._waiting: deque[tuple[float, bytes]] = deque()
        self._condition = threading.Condition()
        self._ended = False
        self.threads = [threading.Thread(target=run, daemon=True) for run in (self._take, self._give)]
        for thread in self.threads:
            thread.start()

    def _take(self) -> None:
        free = time.monotonic()
        while True:
            try:
                data = self._source.recv(Relay.PIECE)
            except OSError:
                data = b""
            if data and self._relay is not None:
                self._relay.carried += len(data)
                while not self._relay.kbit and not self._relay.closed:
                    time.sleep(0.01)
                free = max(free, time.monotonic() - Relay.LATE_S) + len(data) / (max(self._relay.kbit, 1.0) * 125.0)
                while (left := free - time.monotonic()) > 0 and not self._relay.closed:
                    time.sleep(min(left, 0.1))
            with self._condition:
                self._ended = not data
                if data:
                    self._waiting.append((time.monotonic() + self._delay_s, data))
                self._condition.notify()
            if not data:
                return

    def _give(self) -> None:
        while True:
            with self._condition:
                self._condition.wait_for(lambda: bool(self._waiting) or self._ended)
                if not self._waiting:
                    break
                due, data = self._waiting.popleft()
            time.sleep(max(0.0, due - time.monotonic()))
            try:
                self._sink.sendall(data)
            except OSError:
                break
        for one in (self._source, self._sink):
            with contextlib.suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)
