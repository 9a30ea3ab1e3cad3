"""Gate: the process in front of TLS ports, from the side of the program that needs it."""

from __future__ import annotations

import contextlib
import json
import logging
import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import lidarcodec
from lidarcodec.errors import TransportError
from lidarcodec.gate.limits import Limits

logger = logging.getLogger(__name__)

END_S: Final = 2.0
AGAIN_S: Final = 1.0
SAY_S: Final = 3600.0
"""Time after which strangers at the port are mentioned again."""
_PASSED_ON: Final = ("PATH", "HOME", "LANG", "LC_", "LD_", "DYLD_", "PYTHON", "TMPDIR", "VIRTUAL_ENV")


def listener_at(host: str, port: int) -> socket.socket:
    """A socket that listens at an address; `::` takes IPv4 as well.

    Raises TransportError when the address cannot be used.
    """
    try:
        family, kind, protocol, _, where = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        listener = socket.socket(family, kind, protocol)
        try:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            if family == socket.AF_INET6:
                listener.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, int(host != "::"))
            listener.bind(where)
            listener.listen(1024)
        except OSError:
            listener.close()
            raise
    except OSError as error:
        raise TransportError(f"cannot listen on {host} port {port}: {error.strerror or error}") from None
    return listener


class Gate:
    """A process that takes connections for Zenoh. If it dies it is started again, and links are made anew."""

    def __init__(self, listeners: Sequence[tuple[socket.socket, int]], limits: Limits | None = None) -> None:
        """listeners: sockets that listen, each with Zenoh's port on this machine; they belong to the gate from now on.

        Raises TransportError when the system starts no process.
        """
        self._listeners, self._limits = list(listeners), limits or Limits()
        self._lock = threading.Lock()
        self._state: dict[str, Any] = {}
        self._said: dict[str, tuple[float, int]] = {}
        self._closing = threading.Event()
        self._restarts = 0
        try:
            self._process = self._start()
        except OSError as error:
            self._close_listeners()
            raise TransportError(f"the gate of the TLS port cannot be started: {error.strerror or error}") from None
        self._thread = threading.Thread(target=self._run, name="lidarcodec gate", daemon=True)
        self._thread.start()

    def state(self) -> dict[str, Any]:
        """Counts for a status (docs/live.md), and whether the process runs."""
        with self._lock:
            state = dict(self._state)
        running = self._process.poll() is None
        return state | {"running": running, "restarts": self._restarts}

    def close(self) -> None:
        """End the process and all connections through it; harmless when called twice."""
        self._closing.set()
        with contextlib.suppress(OSError):
            if self._process.stdin is not None:
                self._process.stdin.close()
        try:
            self._process.wait(END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._thread.join(END_S)
        self._close_listeners()

    def _close_listeners(self) -> None:
        for listener, _ in self._listeners:
            listener.close()

    def _start(self) -> subprocess.Popen[bytes]:
        environment = {name: value for name, value in os.environ.items() if name.startswith(_PASSED_ON)}
        home = str(Path(lidarcodec.__file__).parents[1])
        environment["PYTHONPATH"] = os.pathsep.join([home, *filter(None, [environment.get("PYTHONPATH")])])
        given = json.dumps([(listener.fileno(), port) for listener, port in self._listeners])
        return subprocess.Popen(
            [sys.executable, "-P", "-m", "lidarcodec.gate", given, self._limits.packed()],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            pass_fds=[listener.fileno() for listener, _ in self._listeners],
            env=environment,
            start_new_session=True,
        )

    def _run(self) -> None:
        while True:
            self._read_states()
            self._process.wait()
            if self._closing.wait(AGAIN_S):
                return
            logger.warning("the gate of the TLS port ended with %s and is started again", self._process.returncode)
            self._restarts += 1
            try:
                process = self._start()
            except OSError as error:
                logger.warning("the gate of the TLS port cannot be started: %s", error.strerror or error)
                continue
            with self._lock:
                self._process = process
            if self._closing.is_set() and process.stdin is not None:
                process.stdin.close()

    def _read_states(self) -> None:
        out = self._process.stdout
        if out is None or out.closed:
            return
        with out:
            for line in out:
                try:
                    state = json.loads(line)
                except ValueError:  # it was killed in the middle of a line
                    continue
                with self._lock:
                    self._state = state
                self._say(state)

    def _say(self, state: dict[str, Any]) -> None:
        """One line for each cause, and again after an hour."""
        now_s = time.monotonic()
        refused = {cause: count for cause, count in state["refused"].items() if count}
        for cause, count in refused.items():
            said_s, before = self._said.get(cause, (float("-inf"), 0))
            if count > before and now_s - said_s >= SAY_S:
                self._said[cause] = now_s, count
                last = f", last {state['last_barred']}" if cause == "barred" and state["last_barred"] else ""
                logger.warning("%d connections to the TLS port were refused: %s%s; further ones are only "
                "counted in the status",
                               count - before, cause, last)  # fmt: skip
