"""`lidarcodec serve` as a process, for what needs a server that can be killed; requests by plain HTTP."""

from __future__ import annotations

import json
import os
import subprocess
import time
import urllib.error
import urllib.request
from pathlib import Path
from typing import Any

from tests.command_line import COMMAND, ROOT, environment
from tests.transport.test_contract import eventually

READY_S = 60.0


class Server:
    """A server process with its database in a folder; it follows a Zenoh meeting point of the machine.

    variables: more of its environment
    """

    def __init__(self, folder: Path, loopback_port: int, port: int, **variables: str) -> None:
        self.url, self.port = f"http://127.0.0.1:{port}", port
        self._environment = environment(
            LIDARCODEC_LOOPBACK_PORT=str(loopback_port),
            LIDARCODEC_DATABASE_URL=f"sqlite:///{folder / 'server.db'}",
            PYTHONPATH=os.pathsep.join([str(ROOT), str(ROOT / "server")]),
            **variables,
        )
        self.process: subprocess.Popen[str] | None = None

    def start(self) -> float:
        """Start it; how long it took until it was ready."""
        begin = time.monotonic()
        self.process = subprocess.Popen(
            [*COMMAND, "serve", "--port", str(self.port)],
            env=self._environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        assert eventually(lambda: self.ask("/readyz")[0] == 200, READY_S), "the server does not become ready"
        return time.monotonic() - begin

    def kill(self) -> None:
        """End it as a power cut would."""
        if self.process is not None:
            self.process.kill()
            self.process.wait(60)

    def ask_text(self, path: str) -> str:
        """The text of an answer."""
        with urllib.request.urlopen(self.url + path, timeout=10) as answer:
            return answer.read().decode()

    def ask(self, path: str, method: str = "GET", body: Any = None) -> tuple[int, Any]:
        """Status and JSON of a request, or the text of an error; (0, None) when nobody answers."""
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(
            self.url + path, data=data, method=method, headers={"Content-Type": "application/json"}
        )
        try:
            with urllib.request.urlopen(request, timeout=10) as answer:
                return answer.status, json.loads(answer.read() or b"null")
        except urllib.error.HTTPError as error:
            with error:
                return error.code, error.read().decode(errors="replace")
        except (OSError, ValueError):
            return 0, None
