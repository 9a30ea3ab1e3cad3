"""What a user loses if these fail: recordings that decode only with the build that wrote them.

By default g++ without optimisation and the core as it was built for the package; LIDARCODEC_COMPILERS=all tries
all ways of `make identity`.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.compilers import FLAGS, ROOT, Build, build, builds, by_kind, hashes

COLUMNS = 120
GOLDEN = {
    "ranges": "281ba164b0fc38b6",
    "ranges with motion": "98a6ba425cc30741",
    "slabs": "dfe42c0406b20577",
    "riddle, ranges": "1c8bee5404a8005b",
    "riddle, ranges with motion": "97b201105f5bca18",
    "riddle, slabs": "45720915f9d84ca6",
    "riddle, bytes, ranges": "84d5befcced49916",
    "riddle, bytes, ranges with motion": "999349d7ac7ccf88",
    "riddle, bytes, slabs": "c1a010882dc997f3",
    "networks": "c27b5467c7f5c223",
    "networks with cases": "6954e6e33def5031",
    "training": "36424b49077276a3",
    "mask": "da0f69b12ad0ee1a",
    "mask of a stream": "c6dd2774adbdd03f",
    "intensity": "03bd171deff4646f",
    "warp": "d77449e8cb63100e",
    "motion search": "8dfa9ab55c2d30af",
}
"""They change only when a format does; CHANGELOG.md then says so."""
ALL = os.environ.get("LIDARCODEC_COMPILERS") == "all"
BUILT = ROOT / "build" / "native" / "liblidarcodec_core.a"


def check(program: Path, runner: tuple[str, ...] = ()) -> None:
    assert by_kind(hashes(program, COLUMNS, runner)) == {kind: {value} for kind, value in GOLDEN.items()}


@pytest.mark.timeout(300)  # compiling all of the core takes most of a minute where nothing else runs
@pytest.mark.parametrize("way", builds() if ALL else [Build("g++", ("-O0",))], ids=str)
def test_every_compiler_and_optimisation_gives_the_same_bytes(way: Build, tmp_path: Path) -> None:
    if way.missing:
        pytest.skip(f"needs {way.missing}")
    check(build(way, tmp_path / "build"), way.runner)


def test_the_core_as_it_was_built_for_the_package_gives_them_too(tmp_path: Path) -> None:
    if not BUILT.exists() or not shutil.which("g++"):
        pytest.skip(f"needs g++ and {BUILT.relative_to(ROOT)}, which `make native` builds")
    program = tmp_path / "codec_bytes"
    source = ROOT / "native" / "check" / "codec_bytes.cpp"
    subprocess.run(["g++", "-O1", *FLAGS, source, BUILT, "-pthread", "-o", program], check=True)
    check(program)
