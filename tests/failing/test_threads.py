"""A service manager starts again what failed. A command that ends with code 0 because it got no thread stays ended."""

from __future__ import annotations

import os
import subprocess
from itertools import product
from pathlib import Path

import pytest

from tests.command_line import COMMAND
from tests.failing import shim
from tests.sweeps import sampled

SOURCE = Path(__file__).with_name("no_threads.c")
ENDS_WITHIN_S = 60.0
COMMANDS = {
    "publish": ("sim:street?frames=5", "--vehicle", "no-threads", "--rate", "20"),
    "subscribe": ("no-threads/lidar", "--frames", "1"),
    "serve": ("--port", "0", "--database-url", "sqlite:///{}/server.db"),
}


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The library that gives no more threads."""
    compiler = shim.compiler()
    if compiler is None:
        pytest.skip("needs a compiler")
    made = tmp_path_factory.mktemp("threads") / "no_threads.so"
    subprocess.run([compiler, "-x", "c", "-shared", "-fPIC", "-o", made, SOURCE, "-ldl"], check=True)
    return made


@pytest.mark.parametrize(
    ("name", "left"), sampled(product(COMMANDS, range(14)), [("publish", 0), ("subscribe", 5), ("serve", 7)])
)
def test_a_command_without_threads_fails_or_does_its_work(tmp_path: Path, library: Path, name: str, left: int) -> None:
    given = [name, *(word.format(tmp_path) for word in COMMANDS[name])]
    environment = os.environ | {"LD_PRELOAD": str(library), "THREADS_LEFT": str(left), "RUST_BACKTRACE": "0"}
    process = subprocess.Popen(
        [*COMMAND, *given], env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path
    )
    try:
        out, complaint = process.communicate(timeout=ENDS_WITHIN_S if name == "publish" else 15.0)
    except subprocess.TimeoutExpired:  # it waits for a stream or for requests: it got the threads that it needs
        process.terminate()
        out, complaint = process.communicate(timeout=ENDS_WITHIN_S)
        assert "can't" not in complaint
        assert "panicked" not in complaint
        return
    finally:
        process.kill()
    if process.returncode == 0:
        assert "5 frames in" in out + complaint, out + complaint
