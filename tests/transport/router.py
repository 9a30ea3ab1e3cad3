"""A Zenoh router as a process, which stands in for `zenohd`: the tests start, kill and restart it, and read its log.

python -m tests.transport.router '{"listen": "tcp/127.0.0.1:7447"}'
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading

from lidarcodec.transport import Endpoints, open_transport
from tests import forks
from tests.conftest import ROOT

LOG = (
    "warn,zenoh_transport::unicast::establishment::accept=debug,zenoh::net::routing::interceptor::access_control=trace"
)
"""docs/deployment.md: what it takes for a router to tell who was refused, and what was denied to whom."""


class Router:
    """A router process. log: what it has written, both its own words and those of the network library."""

    def __init__(self, **endpoints) -> None:
        command = [sys.executable, "-m", "tests.transport.router", json.dumps(endpoints)]
        self.process = forks.Process(
            command,
            cwd=ROOT,
            env=os.environ | {"RUST_LOG": LOG},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self.log = ""
        self._ready = threading.Event()
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()
        assert self._ready.wait(60)
        assert self.process.poll() is None, self.log

    def _read(self) -> None:
        for line in self.process.stdout:
            self.log += line
            if line.strip() == "ready":
                self._ready.set()
        self._ready.set()

    def kill(self) -> None:
        """End it as a power cut would."""
        self.process.kill()
        self.process.wait(60)
        self._thread.join(5)
        self.process.stdout.close()


def main(endpoints: dict[str, str]) -> None:
    with open_transport(Endpoints.of(**({"mode": "router"} | endpoints))):
        os.write(1, b"ready\n")
        threading.Event().wait(3600)


if __name__ == "__main__":
    main(json.loads(sys.argv[1]))
