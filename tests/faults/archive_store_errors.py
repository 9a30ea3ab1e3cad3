"""A store that answers with errors, slowly, or cuts connections: a proxy before an S3 server does it, at random.

What is visible in the end must be the same objects as of a run on a folder that nothing disturbed.
"""

from __future__ import annotations

import contextlib
import http.client
import http.server
import os
import random
import socket
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from tests import command_line
from tests.faults.archive_killed import undisturbed, words
from tests.faults.outcome import Outcome

SEED = 35
SHARES = {"error 500": 0.05, "slow down (503)": 0.05, "cut before": 0.04, "cut after": 0.04, "slow": 0.03}
"""Of the requests: `cut before` the store has seen it, `cut after` it was done and before all of the answer came."""
SLOW_S = 1.0
RUNS = 12
"""So many runs may be needed until the archive is complete."""
PATIENCE_S = 600.0
_OWN = ("content-length", "connection", "transfer-encoding", "date", "server")
"""Headers that the proxy makes itself."""


class Proxy(http.server.ThreadingHTTPServer):
    """Hands requests on to a port of this machine, and disturbs some. counts: of what it did"""

    daemon_threads = True

    def __init__(self, target: int, seed: int) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.target = target
        self.counts: Counter[str] = Counter()
        self.moments = random.Random(seed)
        self.lock = threading.Lock()

    def fault(self) -> str:
        """What happens to the next request; empty for nothing."""
        with self.lock:
            self.counts["requests"] += 1
            at = self.moments.random()
            for name, share in SHARES.items():
                at -= share
                if at < 0:
                    self.counts[name] += 1
                    return name
            return ""

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Connections that are cut on purpose are no errors."""


class _Handler(http.server.BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server: Proxy

    def _handle(self) -> None:
        fault = self.server.fault()
        body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
        if fault == "cut before":
            self._cut()
            return
        if fault in ("error 500", "slow down (503)"):
            code, name = (500, "InternalError") if fault == "error 500" else (503, "SlowDown")
            self._answer(code, {}, f"<Error><Code>{name}</Code><Message>on purpose</Message></Error>".encode())
            return
        if fault == "slow":
            time.sleep(SLOW_S)
        there = http.client.HTTPConnection("127.0.0.1", self.server.target, timeout=60)
        there.request(self.command, self.path, body, dict(self.headers))
        answer = there.getresponse()
        data = answer.read()
        headers = {name: value for name, value in answer.getheaders() if name.lower() not in _OWN}
        length = int(answer.getheader("Content-Length") or len(data)) if self.command == "HEAD" else len(data)
        there.close()
        if fault == "cut after":
            self._answer(answer.status, headers, data, length, part=len(data) // 2)
            self._cut()
            return
        self._answer(answer.status, headers, data, length)

    do_GET = do_PUT = do_POST = do_HEAD = do_DELETE = _handle

    def _answer(
        self, code: int, headers: dict[str, str], data: bytes, length: int | None = None, part: int = -1
    ) -> None:
        if not part:
            return
        self.send_response(code)
        for name, value in headers.items():
            self.send_header(name, value)
        self.send_header("Content-Length", str(len(data) if length is None else length))
        self.end_headers()
        if self.command == "HEAD":  # its answers have no body, those that refuse neither
            return
        self.wfile.write(data if part < 0 else data[:part])
        self.wfile.flush()

    def _cut(self) -> None:
        self.close_connection = True
        with contextlib.suppress(OSError):
            self.connection.shutdown(socket.SHUT_RDWR)

    def log_message(self, *_: Any) -> None:
        """Nothing."""


@contextlib.contextmanager
def proxied(target: int, seed: int, kind: type[Proxy] = Proxy) -> Iterator[Proxy]:
    proxy = kind(target, seed)
    thread = threading.Thread(target=proxy.serve_forever, daemon=True)
    thread.start()
    try:
        yield proxy
    finally:
        proxy.shutdown()
        proxy.server_close()


def run(seed: int = SEED) -> Outcome:
    title = "store of `archive run` answers with errors, slowly, or cuts connections"
    missing = [name for name in ("moto", "flask_cors", "obstore") if find_spec(name) is None]
    if missing:
        return Outcome(title, None, "?", "?", {"note": f"not run: {missing[0]} is not installed"})
    from tests.archive.conftest import Bucket

    wrong: list[str] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        expected = undisturbed(folder)
        bucket = Bucket(folder)
        try:
            with proxied(bucket.port, seed) as proxy:
                runs, left = _until_complete(folder, bucket.variables, proxy.server_address[1])
                counts = dict(proxy.counts)
            found = _objects(bucket.variables)
        finally:
            bucket.close()
    if not runs:
        wrong.append(f"the archive is not complete after {RUNS} runs: {left}")
    if found != expected:
        how = {"missing": expected.keys() - found.keys(), "more": found.keys() - expected.keys()}
        how["other bytes"] = {name for name in found.keys() & expected.keys() if found[name] != expected[name]}
        told = "; ".join(f"{word}: {', '.join(sorted(names))}" for word, names in how.items() if names)
        wrong.append(f"other objects than of an undisturbed run: {told[:500]}")
    faults = sum(counts.values()) - counts["requests"]
    return Outcome(
        title,
        None,
        "nothing: the same objects, byte for byte, as of an undisturbed run",
        "driver: `tried_again`, `left` (exit code 1) until a run completes it",
        {
            "note": f"{faults} of {counts['requests']} requests disturbed; complete after {runs} run(s)",
            "counts": counts,
        },
        wrong,
    )


def _until_complete(folder: Path, variables: dict[str, str], port: int) -> tuple[int, str]:
    """Number of runs until nothing is left to do, 0 if it never came to that; and what was said last."""
    disturbed = variables | {"AWS_ENDPOINT_URL": f"http://127.0.0.1:{port}"}
    command = words(folder, "unused")
    command[2] = "s3://fleet/out"
    said = ""
    for number in range(1, RUNS + 1):
        driver = command_line.start("archive", *command, variables=disturbed)
        try:
            _, said = driver.communicate(timeout=PATIENCE_S)
        finally:
            driver.kill()
        if driver.returncode == 0:
            _join(command, disturbed)
            return number, said
    return 0, said[-2000:]


def _join(command: list[str], disturbed: dict[str, str]) -> None:
    """Join tables, which a run leaves out if the store does not let it."""
    for _ in range(RUNS):
        if command_line.run("archive", *command[:3], "--job", "index", **disturbed).returncode == 0:
            return


def _objects(variables: dict[str, str]) -> dict[str, bytes]:
    """All objects of the archive, read past the proxy."""
    from lidarcodec.archive.stores.table import open_store

    before = dict(os.environ)
    os.environ.update(variables)
    try:
        store = open_store("s3://fleet/out")
        return {entry.name: store.read(entry.name) for entry in store.entries()}
    finally:
        os.environ.clear()
        os.environ.update(before)
