"""What a user loses if these fail: recordings that decode only with the build that wrote them.

By default g++ without optimisation, with frames of few columns, and the core as it was built for the package;
LIDARCODEC_COMPILERS=all tries all ways of `make identity`.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from functools import partial
from pathlib import Path

import pytest

from tests.compilers import FLAGS, ROOT, Build, build, builds, by_kind, hashes
from tests.kept import kept

SMALL, LARGE = 36, 120
"""Columns. Without optimisation a column takes half a second: every path and form of networks is tried with each."""
GOLDEN = {
    # what is coded: of few columns, of many
    "ranges": ("f1ddb9b7984733d1", "0582a8135f63de9e"),
    "ranges with motion": ("c2747421b7ff355e", "60e22fe16496e5ff"),
    "slabs": ("1b36eca85dcba119", "ece6885ba0cc4fee"),
    "quick ranges": ("3f170131a812de9f", "1359f6393c3b1fd9"),
    "quick ranges with motion": ("c1f44f8c36d575da", "080099a49bf15837"),
    "quick slabs": ("1df26e47a2654846", "8b773a202438dbf4"),
    "riddle, ranges": ("ffa61019983a8492", "05f0471d64571dd2"),
    "riddle, ranges with motion": ("7ef58aa6874b684e", "e0bf1040fd379d14"),
    "riddle, slabs": ("7748115b03cc7fad", "f46510033817a76d"),
    "riddle, bytes, ranges": ("2753c2f93f77a24b", "9ea680ba8c55d0d8"),
    "riddle, bytes, ranges with motion": ("4fe3c7dc971f81c9", "790b9d2d59fca84f"),
    "riddle, bytes, slabs": ("07ecd6fdf2fb1516", "14ad696aede8221e"),
    "networks": ("c27b5467c7f5c223", "c27b5467c7f5c223"),
    "networks with cases": ("6954e6e33def5031", "6954e6e33def5031"),
    "networks of few tiles": ("73b036c98a0e448f", "73b036c98a0e448f"),
    "training": ("2e7d497213cf15a2", "d016304f1edd91f2"),
    "mask": ("09e94b116add8d39", "da0f69b12ad0ee1a"),
    "mask of a stream": ("4c613a31c967585e", "c6dd2774adbdd03f"),
    "intensity": ("943e7df0f75e1864", "03bd171deff4646f"),
    "warp": ("d77449e8cb63100e", "d77449e8cb63100e"),
    "motion search": ("8dfa9ab55c2d30af", "8dfa9ab55c2d30af"),
}
"""They change only when a format does; CHANGELOG.md then says so."""
ALL = os.environ.get("LIDARCODEC_COMPILERS") == "all"
BUILT = ROOT / "build" / "native" / "liblidarcodec_core.a"


def check(program: Path, columns: int, runner: tuple[str, ...] = ()) -> None:
    golden = {kind: {values[columns == LARGE]} for kind, values in GOLDEN.items()}
    assert by_kind(hashes(program, columns, runner)) == golden


@pytest.mark.timeout(300)  # compiling all of the core takes most of a minute where nothing else runs
@pytest.mark.parametrize("way", builds() if ALL else [Build("g++", ("-O0",))], ids=str)
def test_every_compiler_and_optimisation_gives_the_same_bytes(way: Build, tmp_path: Path) -> None:
    if way.missing:
        pytest.skip(f"needs {way.missing}")
    if ALL:
        check(build(way, tmp_path / "build"), LARGE, way.runner)
    else:
        check(kept("codec_bytes", way.compiler, (*way.options, *FLAGS), partial(build, way)), SMALL)


def test_the_core_as_it_was_built_for_the_package_gives_them_too(tmp_path: Path) -> None:
    if not BUILT.exists() or not shutil.which("g++"):
        pytest.skip(f"needs g++ and {BUILT.relative_to(ROOT)}, which `make native` builds")
    program, made = tmp_path / "codec_bytes", kept("codec_bytes.o", "g++", ("-O1", *FLAGS), compiled)
    subprocess.run(["g++", made, BUILT, "-pthread", "-o", program], check=True)
    for columns in (SMALL, LARGE):
        check(program, columns)


def compiled(folder: Path) -> Path:
    folder.mkdir()
    made = folder / "codec_bytes.o"
    source = ROOT / "native" / "check" / "codec_bytes.cpp"
    subprocess.run(["g++", "-O1", *FLAGS, "-c", source, "-o", made], check=True)
    return made
