"""MeetingPoint: the loopback port where the processes of one machine find each other.

The process that finds the port free opens a separate session on it, which carries no data. The others connect there,
learn the ports of all processes by gossip, and then connect directly. If this process ends, even by kill -9, the other
links stay, and the next process that finds the port free opens it.
"""

from __future__ import annotations

import logging
import socket
import threading
import time
from collections.abc import Callable

from lidarcodec.errors import TransportError

logger = logging.getLogger(__name__)

CHECK_S = 0.25
ALONE_S = 5.0


def is_free(port: int) -> bool:
    """Whether a listener could be opened on this port of loopback now."""
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError:
            return False
        return True


class MeetingPoint:
    """Holds the port if no other process does. hold: opens the session on it, and returns the function that closes
    it; it
    raises TransportError if another process was faster"""

    def __init__(self, port: int, hold: Callable[[], Callable[[], object]]) -> None:
        self._port, self._hold = port, hold
        self._release: Callable[[], object] | None = None
        self._connected: Callable[[], int] | None = None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="meeting point", daemon=True)

    @property
    def held(self) -> bool:
        """Whether this process holds the port."""
        return self._release is not None

    def start(self) -> None:
        """Try once now, then continue in a thread."""
        self._try()
        self._thread.start()

    def watch(self, connected: Callable[[], int]) -> None:
        """Log a warning if the port is in use but no session is connected: then another program uses it."""
        self._connected = connected

    def close(self) -> None:
        """Stop, and release the port."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(2.0)
        release, self._release = self._release, None
        if release is not None:
            try:
                release()
            except Exception as error:  # for any error of the network library: the process is ending
                logger.debug("closing the meeting point: %s", error)

    def _try(self) -> None:
        # Checked first, because the network library logs every refusal.
        if self._release is None and is_free(self._port):
            try:
                self._release = self._hold()
            except TransportError as error:
                logger.debug("port %d: %s", self._port, error)
            else:
                logger.info("this process holds the meeting point 127.0.0.1:%d", self._port)

    def _run(self) -> None:
        alone_since: float | None = None
        told = False
        while not self._stop.wait(CHECK_S):
            self._try()
            if told or self._connected is None or self.held or self._connected():
                alone_since = None
            elif alone_since is None:
                alone_since = time.monotonic()
            elif time.monotonic() - alone_since > ALONE_S:
                told = True
                logger.warning(
                    "port %d of this machine is used by a program that does not speak Zenoh: choose another "
                    "loopback port",
                    self._port,
                )
