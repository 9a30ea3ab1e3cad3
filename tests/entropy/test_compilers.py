"""What a user loses if these fail: recordings that decode only with the build that wrote them.

By default g++ with little optimisation and the core as it was built for the package, with much; with frames of few
columns. LIDARCODEC_COMPILERS=all tries all ways of `make identity`, those without any optimisation among them.
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
from tests.sweeps import sampled

SMALL, LARGE = 18, 120
"""Columns. Every path and form of networks is tried with each: without optimisation one takes half a second."""
GOLDEN = {
    # what is coded: of few columns, of many
    "ranges": ("c9f0ea7f8e905ce0", "93e5ae1d399f1011"),
    "ranges with motion": ("e1c9782e16e0ba79", "8e6192c791869e54"),
    "slabs": ("8c0a4f790d78041c", "efb0ea8d941387cb"),
    "quick ranges": ("a075cec5d4ce269c", "595195d7bf4e07e2"),
    "quick ranges with motion": ("a5caa4ebe60f684a", "660219bb1b04abc8"),
    "quick slabs": ("3f09699d3c4bf89f", "7d6f773c1f04a13b"),
    "riddle, ranges": ("03fbb6aab714c164", "a5e8b04bf1b21f17"),
    "riddle, ranges with motion": ("4cbbc652d77e15d7", "163e5df0406dfc91"),
    "riddle, slabs": ("16aa3be4bc1ba14c", "50dfee7f125d2446"),
    "riddle, bytes, ranges": ("b2ba33875d88a3e4", "c176290d619ed1a5"),
    "riddle, bytes, ranges with motion": ("3b243c1ae570f9d8", "e8dad5be33c0b0c8"),
    "riddle, bytes, slabs": ("210e795f3bc3a4c5", "2853c31b46fd1cdf"),
    "free ranges": ("50e48c21755d92f7", "bd456a3a2d1d6b2b"),
    "free ranges with motion": ("0169e2ef02fb1851", "3c901477b2cbda8f"),
    "quick free ranges": ("7c36992896b6d3ef", "c4f62448b015c3fc"),
    "quick free ranges with motion": ("b533ad779cac72b9", "fd59e3550b02f76b"),
    "riddle, free ranges": ("7e4412efddf50998", "26f0382b05cff868"),
    "riddle, free ranges with motion": ("8ca0331f130a835c", "8d1b758b48d5d522"),
    "riddle, bytes, free ranges": ("c6a54cc075d9fc9e", "cecbd86e50a63323"),
    "riddle, bytes, free ranges with motion": ("0e4fab7ba7205256", "90e5ee012c1d3fee"),
    "networks": ("c27b5467c7f5c223", "c27b5467c7f5c223"),
    "networks with cases": ("6954e6e33def5031", "6954e6e33def5031"),
    "networks of few tiles": ("73b036c98a0e448f", "73b036c98a0e448f"),
    "training": ("c016e7bf53be8b7a", "d016304f1edd91f2"),
    "mask": ("b6af6382f27b41d2", "da0f69b12ad0ee1a"),
    "mask of a stream": ("4cd27dca36f42094", "c6dd2774adbdd03f"),
    "intensity": ("f46687cc2f893890", "03bd171deff4646f"),
    "few intensities": ("7c9486314e1008a6", "142fcf848ae25871"),
    "warp": ("d77449e8cb63100e", "d77449e8cb63100e"),
    "motion search": ("8dfa9ab55c2d30af", "8dfa9ab55c2d30af"),
}
"""They change only when a format does; CHANGELOG.md then says so."""
ALL = os.environ.get("LIDARCODEC_COMPILERS") == "all"
BUILT = ROOT / "build" / "native" / "liblidarcodec_core.a"


def check(program: Path, columns: int, runner: tuple[str, ...] = ()) -> None:
    golden = {kind: {values[columns == LARGE]} for kind, values in GOLDEN.items()}
    assert by_kind(hashes(program, columns, runner)) == golden


@pytest.mark.sweep
@pytest.mark.timeout(300)  # compiling all of the core takes most of a minute where nothing else runs
@pytest.mark.parametrize("way", builds() if ALL else [Build("g++", ("-O1",))], ids=str)
def test_every_compiler_and_optimisation_gives_the_same_bytes(way: Build, tmp_path: Path) -> None:
    if way.missing:
        pytest.skip(f"needs {way.missing}")
    if ALL:
        check(build(way, tmp_path / "build"), LARGE, way.runner)
    else:
        check(kept("codec_bytes", way.compiler, (*way.options, *FLAGS), partial(build, way)), SMALL)


@pytest.mark.parametrize("columns", sampled([SMALL, LARGE], [SMALL]))
@pytest.mark.sweep
def test_the_core_as_it_was_built_for_the_package_gives_them_too(tmp_path: Path, columns: int) -> None:
    if not BUILT.exists() or not shutil.which("g++"):
        pytest.skip(f"needs g++ and {BUILT.relative_to(ROOT)}, which `make native` builds")
    program, made = tmp_path / "codec_bytes", kept("codec_bytes.o", "g++", ("-O1", *FLAGS), compiled)
    subprocess.run(["g++", made, BUILT, "-pthread", "-o", program], check=True)
    check(program, columns)


def compiled(folder: Path) -> Path:
    folder.mkdir()
    made = folder / "codec_bytes.o"
    source = ROOT / "native" / "check" / "codec_bytes.cpp"
    subprocess.run(["g++", "-O1", *FLAGS, "-c", source, "-o", made], check=True)
    return made
