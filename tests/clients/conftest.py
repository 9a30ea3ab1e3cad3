"""The C library as programs find it."""

from __future__ import annotations

import fcntl
import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.clients.c_session import CSession
from tests.conftest import ROOT

BUILD = ROOT / "build" / "native"


@pytest.fixture(scope="session")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The library as `cmake --install` puts it into a folder."""
    if not list((BUILD / "native" / "c").glob("liblidarcodec.*")):
        pytest.skip(
            "needs the headers of zstd and zlib when the native core is built: apt install libzstd-dev zlib1g-dev"
        )
    prefix = tmp_path_factory.mktemp("installed")
    words = ["cmake", "--install", str(BUILD), "--prefix", str(prefix), "--component", "c"]
    subprocess.run(words, check=True, capture_output=True, timeout=60)
    return prefix


@pytest.fixture(scope="session")
def programs(installed: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the programs of clients/cpp, built against the library as it is installed.

    All processes of `pytest -n` share it: the first one builds, the others wait.
    """
    if shutil.which("cmake") is None:
        pytest.skip("needs cmake")
    base = tmp_path_factory.getbasetemp()
    build = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "programs"
    words = ["cmake", "-S", str(ROOT / "clients" / "cpp"), "-B", str(build), f"-DCMAKE_PREFIX_PATH={installed}"]
    with build.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        for step in (words, ["cmake", "--build", str(build)]) if not (build / "built").exists() else ():
            subprocess.run(step, check=True, capture_output=True, timeout=300)
        (build / "built").touch()
    return build


@pytest.fixture
def bare(installed: Path) -> Iterator[CSession]:
    """A session to which nothing is given."""
    made = CSession(next(installed.rglob("liblidarcodec.so")))
    yield made
    made.close()
