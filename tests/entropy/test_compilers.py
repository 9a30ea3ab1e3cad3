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

SMALL, LARGE = 18, 120
"""Columns. Every path and form of networks is tried with each: without optimisation one takes half a second."""
GOLDEN = {
    # what is coded: of few columns, of many
    "ranges": ("754f9541b75017ef", "05ce9d328602da1e"),
    "ranges with motion": ("2766fd48378fa0f2", "96fca86cdcfd547f"),
    "slabs": ("881f615fe9ad865d", "bfd3dc61c1fda56e"),
    "quick ranges": ("43aaf41665acd9c3", "1359f6393c3b1fd9"),
    "quick ranges with motion": ("4f16c85a30413787", "080099a49bf15837"),
    "quick slabs": ("b6df208227454516", "8b773a202438dbf4"),
    "riddle, ranges": ("1fbacb4f78205467", "270bf3097c1fac52"),
    "riddle, ranges with motion": ("82dfc0b3aad316b6", "4880c6326446e894"),
    "riddle, slabs": ("f01f66b4e08be8ad", "a6bb65ff19b55eed"),
    "riddle, bytes, ranges": ("fbf36465b262cc1d", "f3dfd1cb832d7b58"),
    "riddle, bytes, ranges with motion": ("4fbc5cbcd7a40421", "39b42c384a0884cf"),
    "riddle, bytes, slabs": ("e783088f52ee95e0", "57e90a160cefa29e"),
    "free ranges": ("997c6fcb271730f4", "ce8561cdb9e17e7c"),
    "free ranges with motion": ("6b65cf633deb9e94", "7d3e8f5520194a04"),
    "quick free ranges": ("d12ca9a594c6e8a2", "f61baf9ace8cad0f"),
    "quick free ranges with motion": ("06bb0845b4fe1da6", "8f23b51f04df6860"),
    "riddle, free ranges": ("5301f56cc386f36f", "f5eb9485020dfa83"),
    "riddle, free ranges with motion": ("2f68159a74b9bb03", "e57d686b511869c3"),
    "riddle, bytes, free ranges": ("92c121f37a95e1ef", "84260fdda2c26fc0"),
    "riddle, bytes, free ranges with motion": ("fe7871628326a93b", "4bcabbac4320265d"),
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


@pytest.mark.timeout(300)  # compiling all of the core takes most of a minute where nothing else runs
@pytest.mark.parametrize("way", builds() if ALL else [Build("g++", ("-O1",))], ids=str)
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
