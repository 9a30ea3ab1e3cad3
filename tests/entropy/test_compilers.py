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
    "ranges": ("8938d685e31ec589", "281ba164b0fc38b6"),
    "ranges with motion": ("5ff8beb7e8d7a907", "98a6ba425cc30741"),
    "slabs": ("3224c1d887828275", "dfe42c0406b20577"),
    "quick ranges": ("d5567f4253e027f8", "8f76317a6033ebaa"),
    "quick ranges with motion": ("f9dba7ed45e0e0dd", "6d2595f7f8cb8a1a"),
    "quick slabs": ("0b71df118b0c49a5", "2cf168f66f5ec064"),
    "riddle, ranges": ("5cf0a8fff4c80bfd", "1c8bee5404a8005b"),
    "riddle, ranges with motion": ("39b638ef385b6585", "97b201105f5bca18"),
    "riddle, slabs": ("43064d0797c57924", "45720915f9d84ca6"),
    "riddle, bytes, ranges": ("c82fd3b7f32b21fd", "84d5befcced49916"),
    "riddle, bytes, ranges with motion": ("41ab43fa9fc3a3c6", "999349d7ac7ccf88"),
    "riddle, bytes, slabs": ("6d4a2af930342b3b", "c1a010882dc997f3"),
    "networks": ("c27b5467c7f5c223", "c27b5467c7f5c223"),
    "networks with cases": ("6954e6e33def5031", "6954e6e33def5031"),
    "networks of few tiles": ("73b036c98a0e448f", "73b036c98a0e448f"),
    "training": ("9521f26dbb313587", "36424b49077276a3"),
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
