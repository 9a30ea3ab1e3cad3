"""The C library as programs find it."""

from __future__ import annotations

import fcntl
import os
import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.clients.c_session import CSession
from tests.conftest import ROOT

BUILD = ROOT / "build" / "native"
Build = Callable[[str, Callable[[Path], None]], Path]
"""Gives the folder of a name, which the function makes if it was not made in this run."""


@pytest.fixture(scope="session")
def built_once(tmp_path_factory: pytest.TempPathFactory) -> Build:
    """A folder that is built once in a run of the tests, for all processes of `pytest -n`.

    It stays below build/, so that the next run only builds what has changed.
    """
    base = tmp_path_factory.getbasetemp()
    of_run = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base

    def build(name: str, make: Callable[[Path], None]) -> Path:
        folder, done = ROOT / "build" / "tests" / name, of_run / f"{name}.built"
        with (of_run / f"{name}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not done.exists():
                make(folder)
                done.touch()
        return folder

    return build


@pytest.fixture(scope="session")
def installed(built_once: Build) -> Path:
    """The library as `cmake --install` puts it into a folder."""
    if not list((BUILD / "native" / "c").glob("liblidarcodec.*")):
        pytest.skip(
            "needs the headers of zstd and zlib when the native core is built: apt install libzstd-dev zlib1g-dev"
        )

    def make(folder: Path) -> None:
        shutil.rmtree(folder, ignore_errors=True)
        words = ["cmake", "--install", str(BUILD), "--prefix", str(folder), "--component", "c"]
        subprocess.run(words, check=True, capture_output=True, timeout=60)

    return built_once("c-library", make)


@pytest.fixture(scope="session")
def programs(installed: Path, built_once: Build) -> Path:
    """The folder of the programs of clients/cpp, built against the library as it is installed."""
    if shutil.which("cmake") is None:
        pytest.skip("needs cmake")

    def make(folder: Path) -> None:
        words = ["cmake", "-S", str(ROOT / "clients" / "cpp"), "-B", str(folder), f"-DCMAKE_PREFIX_PATH={installed}"]
        for step in (words, ["cmake", "--build", str(folder)]):
            subprocess.run(step, check=True, capture_output=True, timeout=300)

    return built_once("c-programs", make)


@pytest.fixture
def bare(installed: Path) -> Iterator[CSession]:
    """A session to which nothing is given."""
    made = CSession(next(installed.rglob("liblidarcodec.so")))
    yield made
    made.close()
