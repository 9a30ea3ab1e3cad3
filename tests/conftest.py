"""Shared fixtures: where the captures are, and short real streams."""

from __future__ import annotations

import atexit
import gc
import os
import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from tests.sweeps import examples

ROOT = Path(__file__).resolve().parent.parent

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # a thread for each core waits busily beside other tests
# Every HTTP client would read the world's authorities first, for 30 ms, and no test goes there.
os.environ.setdefault("SSL_CERT_FILE", str(ROOT / "tests" / "nobody.pem"))
settings.register_profile(
    "any machine", deadline=None, max_examples=examples(100), suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("any machine")  # no test fails because the machine is slow
gc.disable()  # until the tests are collected: nearly all that comes until then stays to the end


def pytest_collection_finish() -> None:
    """Leave the thousands of tests out of every garbage collection: a twelfth of the processor time goes there.

    Python takes them with the rest when it ends. Before that pytest collects twice, for nothing that is in them.
    """
    gc.freeze()
    gc.enable()
    atexit.register(gc.unfreeze)


def pytest_sessionfinish() -> None:
    """End what programs were forked from."""
    if forks := sys.modules.get("tests.forks"):
        forks.end()


def data_folder() -> Path:
    """Folder of the shared captures: LIDARCODEC_DATA, else ../shared/data beside the checkout."""
    return Path(os.environ.get("LIDARCODEC_DATA", ROOT.parent / "shared" / "data"))


@pytest.fixture(scope="session")
def data_file():
    """Function from a file's name to its path; skips the test, by name, when it is not there."""

    def find(name: str) -> Path:
        path = data_folder() / name
        if not path.exists():
            pytest.skip(f"needs {name} in LIDARCODEC_DATA (looked in {data_folder()})")
        return path

    return find
