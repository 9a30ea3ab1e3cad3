"""Tells systemd that a service is ready, that it is alive, and that it ends: the protocol of sd_notify(3).

systemd names a socket in NOTIFY_SOCKET to services of `Type=notify`, and says in WATCHDOG_USEC how often it wants to
hear that they are alive (`WatchdogSec=`). Without these variables nothing is sent.

>>> Manager.of({"NOTIFY_SOCKET": "/run/systemd/notify", "WATCHDOG_USEC": "30000000"}).every_s
10.0
>>> Manager.of({}).every_s is None
True
"""

from __future__ import annotations

import logging
import os
import re
import socket
import threading
from collections.abc import Callable, Iterator, MutableMapping
from contextlib import contextmanager
from typing import Final, Self

from lidarcodec.apps.ending import ended

logger = logging.getLogger(__name__)

VARIABLES: Final = ("NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID")
A_LIMIT: Final = 3
"""A service says that it is alive this often within the time after which systemd ends it."""
SEND_S: Final = 1.0
AGAIN_S: Final = 1.0
"""Interval at which it is tried again to say that the service is ready: without that, the manager ends the service."""
MICROSECONDS: Final = re.compile(r"[1-9][0-9]{0,15}")


class Manager:
    """The service manager that started this process. every_s: seconds between two calls of `alive`; None: never"""

    def __init__(self, address: str | None = None, every_s: float | None = None) -> None:
        """address: path of its socket, or a name that begins with `@`"""
        self._address, self.every_s = address, every_s if address else None
        self.wait_s = SEND_S
        """Longest wait while the socket of the manager is full."""
        self._complained = False

    @classmethod
    def of(cls, variables: MutableMapping[str, str]) -> Self:
        """The one in these variables. They are removed, so that processes that this one starts do not use them."""
        address, limit, process = (variables.pop(name, "") for name in VARIABLES)
        if not address.startswith(("/", "@")):
            return cls()
        meant = MICROSECONDS.fullmatch(limit) is not None and process in ("", str(os.getpid()))
        return cls(address, int(limit) / 1e6 / A_LIMIT if meant else None)

    def ready(self, text: str) -> bool:
        """The service works from here on. text: what it does, for `systemctl status`

        Returns whether the manager got it, or there is none.
        """
        return self._send(f"READY=1\nSTATUS={' '.join(text.split())}")

    def alive(self) -> bool:
        """The service still works. Returns whether the manager got it, or there is none."""
        return self._send("WATCHDOG=1")

    def stopping(self) -> None:
        """The service has begun to end."""
        self._send("STOPPING=1")

    def _send(self, text: str) -> bool:
        if self._address is None:
            return True
        address = f"\0{self._address[1:]}" if self._address.startswith("@") else self._address
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as out:
                out.settimeout(self.wait_s)
                out.sendto(text.encode(), address)
        except (OSError, ValueError) as error:
            if not self._complained:
                logger.warning("the service manager at %s does not receive notifications: %s", self._address, error)
            self._complained = True
            return False
        return True


@contextmanager
def told_ready(text: str, state: Callable[[], object]) -> Iterator[None]:
    """Tell the service manager that the service is ready, and then again and again that it is alive.

    state: reads the state of the service, in a thread. While it does not return, nothing is sent, and the manager
    starts the service again.
    """
    manager = Manager.of(os.environ)
    stop = threading.Event()

    def run(ready: bool) -> None:
        while not ready and not stop.wait(AGAIN_S):  # its socket was full, or not there yet
            ready = manager.ready(text)
        while manager.every_s is not None and not stop.wait(manager.every_s):
            try:
                state()
            except Exception:  # it answered, so it is alive
                logger.exception("the state of the service could not be sent to the service manager")
            manager.alive()

    ready = manager.ready(text)
    threads = []
    if manager.every_s is not None or not ready:
        threads.append(threading.Thread(target=run, args=(ready,), name="lidarcodec alive", daemon=True))
        threads[0].start()
    try:
        yield
    finally:
        manager.stopping()
        stop.set()
        ended(threads)
