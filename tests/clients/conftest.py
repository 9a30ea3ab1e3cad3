"""The C library as programs find it."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.clients.c_session import CSession
from tests.conftest import ROOT

BUILD = ROOT / "build" / "native"


@pytest.fixture(scope="module")
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


@pytest.fixture(scope="module")
def programs(installed: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the programs of clients/cpp, built against the library as it is installed."""
    if shutil.which("cmake") is None:
        pytest.skip("needs cmake")
    build = tmp_path_factory.mktemp("programs")
    words = ["cmake", "-S", str(ROOT / "clients" / "cpp"), "-B", str(build), f"-DCMAKE_PREFIX_PATH={installed}"]
    for step in (words, ["cmake", "--build", str(build)]):
        subprocess.run(step, check=True, capture_output=True, timeout=300)
    return build


@pytest.fixture
def bare(installed: Path) -> Iterator[CSession]:
    """A session to which nothing is given."""
    made = CSession(next(installed.rglob("liblidarcodec.so")))
    yield made
    made.close()
