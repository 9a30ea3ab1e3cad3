"""A store for tests: a folder, and a bucket of moto's S3 server on loopback."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path

import pytest

pytest.importorskip("duckdb", reason="needs the extra archive")
pytest.importorskip("obstore", reason="needs the extra archive")

from lidarcodec.sources import open_source
from tests.command_line import run_here
from tests.transport.conftest import free_port

UP_S = 60.0
FRAMES = 13
SHORT = ("--workers", "here", "--seconds", "1")


class Bucket:
    """moto's server and a bucket in it. log: a line for each request"""

    def __init__(self, folder: Path) -> None:
        self.port = free_port()
        self.log = folder / "requests.log"
        self.variables = {
            "AWS_ACCESS_KEY_ID": "test",
            "AWS_SECRET_ACCESS_KEY": "test",
            "AWS_REGION": "us-east-1",
            "AWS_ALLOW_HTTP": "true",
            "AWS_ENDPOINT_URL": f"http://127.0.0.1:{self.port}",
        }
        words = [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(self.port)]
        with self.log.open("wb") as log:
            self._process = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=log)
        begun_s = time.monotonic()
        while True:
            try:
                self._ask("PUT", "/fleet").close()
                break
            except (OSError, urllib.error.URLError):
                if time.monotonic() - begun_s > UP_S or self._process.poll() is not None:
                    self.close()
                    raise
                time.sleep(0.1)

    def put(self, key: str, data: bytes) -> None:
        """An object with any key, past the checks of our own code."""
        self._ask("PUT", f"/fleet/{key}", data).close()

    def _ask(self, method: str, path: str, data: bytes | None = None):
        url = f"http://127.0.0.1:{self.port}{path}"
        return urllib.request.urlopen(urllib.request.Request(url, data=data, method=method), timeout=60)

    def requests(self) -> list[str]:
        """Requests for objects so far."""
        return [line for line in self.log.read_text().splitlines() if "/fleet" in line]

    def close(self) -> None:
        self._process.kill()
        self._process.wait()


@pytest.fixture(scope="session")
def bucket(tmp_path_factory):
    """A bucket `fleet`; its address and keys are in the environment."""
    pytest.importorskip("moto", reason="needs moto, of the extra dev")
    pytest.importorskip("flask_cors", reason="needs flask-cors, of the extra dev")
    found = Bucket(tmp_path_factory.mktemp("moto"))
    before = {name: os.environ.get(name) for name in found.variables}
    os.environ.update(found.variables)
    yield found
    found.close()
    for name, value in before.items():
        os.environ.pop(name, None)
        if value is not None:
            os.environ[name] = value


@pytest.fixture(scope="session")
def drive(tmp_path_factory) -> Path:
    """A folder with a short simulated capture of car-7/roof: 1.2 s of a VLP-16, which are two segments of a second."""
    from tests.drives import simulated

    folder = tmp_path_factory.mktemp("drive") / "car-7" / "roof"
    folder.mkdir(parents=True)
    simulated("sim:city?sensor=vlp16&frames=13", folder / "drive.pcap")
    return folder.parent.parent


@pytest.fixture
def inputs(drive, tmp_path) -> Path:
    """A copy of that folder, which a test may change."""
    target = tmp_path / "in"
    shutil.copytree(drive, target)
    return target


@contextlib.contextmanager
def unchanged(folder: Path):
    """Checks that nothing in a folder changes."""
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    yield
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*")} == before


def payloads(path: Path) -> list[bytes]:
    with open_source(path) as source:
        return [packet.payload for packet in source.packets()]


def archive(*words, code: int = 0):
    done = run_here("archive", *map(str, words))
    assert done.returncode == code, done.stderr
    return done


@pytest.fixture(scope="module")
def made(drive, tmp_path_factory):
    out = tmp_path_factory.mktemp("made") / "out"
    archive("run", drive, out, *SHORT)
    return out


@pytest.fixture
def filled(made, tmp_path):
    """A copy of the archive of the short drive."""
    return Path(shutil.copytree(made, tmp_path / "out"))


def objects(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
