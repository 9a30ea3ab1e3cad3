"""What a user loses if these fail: drives that are the same on every machine. Recordings, figures and weights that name
a seed would mean something else.

The hashes change only when the simulation is changed on purpose; CHANGELOG.md then says so. By default one other
compiler than the module's is tried; LIDARCODEC_COMPILERS=all tries all that are here, with and without optimisation.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import pytest

from lidarcodec.sources.simulator import START_NS, _native
from tests.conftest import ROOT
from tests.kept import kept

GOLDEN = {
    # scene, seed, packets left out, packets: SHA-256 of the payloads
    ("city", 1, 0, 348): "638c23b5b924da98d5845ad16779a470af2c97cac6ecfaa066d674149c60922c",
    ("city", 2, 200_000, 232): "021a76d9ed25a4d8ce683a5926e302a56bbd714f79e58910420e8ff79b29c498",
    ("city", 2**53 - 1, 1_000_000, 116): "8e39ebf3563b156d27eee8977f36b0c08f7553a378c12903b66d6a46687ee0d7",
    ("road", 1, 0, 116): "5ae1e78288f67a26bf86312021a74dbc6840bd9a14019a070941903c1c4ab1af",
    ("road", 4, 100_000, 116): "ffe57360dffd2c9c0ac5532ebf540fe6c89b9a919912c5ee63c0f8bacfd937d8",
    ("street", 1, 0, 116): "4ed181fbda3b6fdaa9e9d3930013b875dd73b636793a7ab2c29c126047b87557",
    ("street", 3, 50_000, 116): "9ebb7689d88eee48cb2fb89034c8c8e92aa3878a2b7e29988f732d774430b478",
    ("bend", 1, 0, 116): "31bfc78f41f640ecaa5bd5d184ff0bc5cf30105e38850cb879de2af34db71653",
    ("bend", 3, 50_000, 116): "cb1cecc4d37cec3bb3725bc43d00aff596815d1bb8f5711c1c356a796b6a78db",
    ("motorway", 1, 0, 116): "05b5b862dd3bb937616200042a67bf41fc7df916b6f80979ba832899b1481e3c",
    ("motorway", 2, 100_000, 116): "2c0fc2de306c121ee9379bedb60aa0bcb2a0351468a1b1ea76a07a4d412bb5e5",
    ("garage", 1, 0, 116): "48e4dbac704dcb27d338c95688aa7caff6357b7fd3169972fec001de6605b51a",
    ("garage", 2, 50_000, 116): "6ca8cbfc0a2f8c1bd74cdfb69f8e8733faf2535e89aee63d843f7b8bb098c66f",
    ("room", 1, 0, 116): "37e07dc3bbd41e61d9d316c72dff1d1bbacf23cbb418703160c5626653145ac3",
    ("room", 2, 50_000, 116): "09470b34cf5e4495617775b4b4d7cde8468b9b375249e533dfc70ca9cfde62a5",
}
COMPILERS = ("clang++", "clang++-14", "g++")
FLAGS = ("-std=c++20", "-ffp-contract=off", f"-I{ROOT / 'native' / 'src'}")
ALL = os.environ.get("LIDARCODEC_COMPILERS") == "all"


@pytest.mark.parametrize("drive", GOLDEN, ids=lambda drive: "-".join(map(str, drive)))
def test_the_bytes_are_those_of_every_other_machine(drive):
    scene, seed, skip, packets = drive
    simulator = _native.Simulator(scene, seed, 0.0, 1.0, START_NS)
    simulator.skip(skip)
    assert hashlib.sha256(simulator.packets(packets).tobytes()).hexdigest() == GOLDEN[drive]


def builds() -> list[tuple[str, str]]:
    """Compilers and optimisations to try."""
    here = [name for name in COMPILERS if shutil.which(name)]
    if not ALL:
        return [(here[0], "-O0")] if here else []
    return [(name, level) for name in here for level in ("-O0", "-O3")]


def build(folder: Path, compiler: str, level: str) -> Path:
    """The program native/check/simulator_bytes.cpp, built from the core alone."""
    sources = [
        *sorted((ROOT / "native" / "src" / "simulator").rglob("*.cpp")),
        ROOT / "native" / "check" / "simulator_bytes.cpp",
    ]
    folder.mkdir()

    def compile_one(source: Path) -> Path:
        made = folder / f"{source.stem}.o"
        subprocess.run([compiler, level, *FLAGS, "-c", source, "-o", made], check=True)
        return made

    with ThreadPoolExecutor(2) as pool:
        objects = list(pool.map(compile_one, sources))
    program = folder / "simulator_bytes"
    subprocess.run([compiler, *objects, "-o", program], check=True)
    return program


@pytest.mark.sweep
@pytest.mark.timeout(600)
@pytest.mark.parametrize(("compiler", "level"), builds() or [("none", "")])
def test_every_compiler_gives_the_same_bytes(compiler, level):
    if not level:
        pytest.skip(f"needs one of {', '.join(COMPILERS)}")
    make = partial(build, compiler=compiler, level=level)
    program = kept(f"simulator_bytes {compiler} {level}", compiler, (level, *FLAGS), make)
    for drive, expected in GOLDEN.items():
        done = subprocess.run([program, *map(str, drive)], check=True, capture_output=True)
        assert hashlib.sha256(done.stdout).hexdigest() == expected, f"{compiler} {level}: {drive}"
