"""What a user would lose: a decoder in another language that agrees with ours, and the program he starts from."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from lidarcodec.settings import StreamSettings
from tests.conftest import ROOT
from tests.server.live import running

CLIENT = ROOT / "clients" / "typescript"


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> Path:
    """The decoder, compiled: a folder with src, test and examples."""
    compiler = CLIENT / "node_modules" / "typescript" / "bin" / "tsc"
    if shutil.which("node") is None or not compiler.is_file():
        pytest.skip("needs node, and `npm ci` in clients/typescript once")
    out = CLIENT / "dist" / f"tests-{os.getpid()}"
    subprocess.run(["node", str(compiler), "--outDir", str(out)], cwd=CLIENT, check=True, timeout=300)
    yield out
    shutil.rmtree(out)


def test_it_agrees_with_the_vectors_and_survives_hostile_bytes(built):
    files = sorted(str(path) for path in (built / "test").glob("*.test.js"))
    words = ["node", "--test", *files]
    result = subprocess.run(words, cwd=CLIENT, capture_output=True, text=True, check=False, timeout=300)
    assert result.returncode == 0, result.stdout[-4000:]
    assert int(re.search(r"^# pass (\d+)", result.stdout, re.M)[1]) >= 15


def test_the_example_prints_the_points_of_a_live_stream(built, tmp_path):
    with running(tmp_path) as server, server.publisher(settings=StreamSettings(codec="zstd")):
        assert server.seen()
        words = [f"ws://127.0.0.1:{server.port}/api/v1/streams/vehicle/lidar/frames", "2"]
        program = ["node", *_socket_option(), str(built / "examples" / "print_points.js"), *words]
        said = subprocess.run(program, cwd=CLIENT, capture_output=True, text=True, check=True, timeout=120).stdout
    assert said.startswith("vehicle/lidar\n")
    assert len(re.findall(r"^frame \d+: \d+ points, the first at ", said, re.M)) == 2


def _socket_option() -> list[str]:
    version = subprocess.run(["node", "--version"], capture_output=True, text=True, check=True, timeout=60).stdout
    return ["--experimental-websocket"] if int(version.removeprefix("v").split(".")[0]) < 22 else []


def test_the_lock_file_names_no_registry():
    assert '"resolved"' not in (CLIENT / "package-lock.json").read_text()
