"""The C library as programs find it."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

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
