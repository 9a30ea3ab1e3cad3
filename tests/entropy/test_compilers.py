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
    "ranges": ("1df346c455b28a51", "05ce9d328602da1e"),
    "ranges with motion": ("ce7251851bec82de", "96fca86cdcfd547f"),
    "slabs": ("0b2d901bed3a4799", "bfd3dc61c1fda56e"),
    "quick ranges": ("3f170131a812de9f", "1359f6393c3b1fd9"),
    "quick ranges with motion": ("c1f44f8c36d575da", "080099a49bf15837"),
    "quick slabs": ("1df26e47a2654846", "8b773a202438dbf4"),
    "riddle, ranges": ("b58cd8247ce0c912", "270bf3097c1fac52"),
    "riddle, ranges with motion": ("bb65ce9a9b18efce", "4880c6326446e894"),
    "riddle, slabs": ("df9c7c844c08892d", "a6bb65ff19b55eed"),
    "riddle, bytes, ranges": ("0b28c65a2508d2cb", "f3dfd1cb832d7b58"),
    "riddle, bytes, ranges with motion": ("8dccf71eedee3849", "39b42c384a0884cf"),
    "riddle, bytes, slabs": ("c5dd0cddf1bc7596", "57e90a160cefa29e"),
    "free ranges": ("cc6006770f0da312", "ce8561cdb9e17e7c"),
    "free ranges with motion": ("4230abc2e8796852", "7d3e8f5520194a04"),
    "quick free ranges": ("241616d3efb37a64", "f61baf9ace8cad0f"),
    "quick free ranges with motion": ("e78286ffdde15d1f", "8f23b51f04df6860"),
    "riddle, free ranges": ("9a1562572e6ac95b", "f5eb9485020dfa83"),
    "riddle, free ranges with motion": ("0be92fd579669aba", "e57d686b511869c3"),
    "riddle, bytes, free ranges": ("2359780f7cad273c", "84260fdda2c26fc0"),
    "riddle, bytes, free ranges with motion": ("d6c86a23ffb6a75e", "4bcabbac4320265d"),
    "networks": ("c27b5467c7f5c223", "c27b5467c7f5c223"),
    "networks with cases": ("6954e6e33def5031", "6954e6e33def5031"),
    "networks of few tiles": ("73b036c98a0e448f", "73b036c98a0e448f"),
    "training": ("2e7d497213cf15a2", "d016304f1edd91f2"),
    "mask": ("09e94b116add8d39", "da0f69b12ad0ee1a"),
    "mask of a stream": ("4c613a31c967585e", "c6dd2774adbdd03f"),
    "intensity": ("943e7df0f75e1864", "03bd171deff4646f"),
    "few intensities": ("fec05fdd077b905d", "142fcf848ae25871"),
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
