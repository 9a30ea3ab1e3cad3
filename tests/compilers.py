"""The same bytes whatever compiled the core: builds native/check/codec_bytes.cpp in every way at hand, and compares.

python -m tests.compilers [--columns 300] [--only TEXT]     also: make identity

Compilers: g++, clang++, each with -O0 to -O3, for any x86-64 and for the processor at hand, and for 64-bit ARM the
cross compiler aarch64-linux-gnu-g++, and clang++ with its libraries; their programs run under qemu-aarch64, or its
static build, as a processor that has all there is and, once, as one without dot products. What is not installed is
named and left out. The program itself tries every path and every form of networks that the processor can run, and
decodes what it coded.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
SOURCES = (
    "predictive/*",
    "network/*",
    "base/*",
    "bits/*",
    "mask/*",
    "motion/*",
    "planes/intensity_*",
)
"""Files of native/src that the program needs, without .cpp."""
FLAGS = ("-std=c++20", "-ffp-contract=off", f"-I{ROOT / 'native' / 'src'}")
LEVELS = ("-O0", "-O1", "-O2", "-O3")


class Build(NamedTuple):
    """A way to build: compiler, its options, what runs the program, and whose libraries are needed."""

    compiler: str
    options: tuple[str, ...]
    runner: tuple[str, ...] = ()
    libraries_of: tuple[str, ...] = ()

    def __str__(self) -> str:
        return " ".join((self.compiler, *self.options, *self.runner[1:]))

    @property
    def missing(self) -> str:
        """The program that is not installed, or nothing."""
        needed = (self.compiler, *self.runner[:1], *self.libraries_of)
        return next((name for name in needed if not shutil.which(name)), "")


def builds() -> list[Build]:
    """All ways."""
    here = [
        Build(compiler, (level, march))
        for compiler in ("g++", "clang++")
        for level in LEVELS
        for march in ("-march=x86-64" if os.uname().machine == "x86_64" else "-mtune=generic", "-march=native")
    ]
    cross, emulator = "aarch64-linux-gnu-g++", "qemu-aarch64"
    if shutil.which(emulator) is None and shutil.which(f"{emulator}-static"):  # Debian has a package of each
        emulator = f"{emulator}-static"
    arm = [Build(cross, (level, "-static"), (emulator,)) for level in LEVELS]
    arm.append(Build(cross, ("-O2", "-static"), (emulator, "-cpu", "cortex-a53")))
    for_arm = "--target=aarch64-linux-gnu"
    arm += [Build("clang++", (for_arm, level, "-static"), (emulator,), (cross,)) for level in ("-O0", "-O2")]
    return here + arm


def build(way: Build, folder: Path, jobs: int = 2) -> Path:
    """The program, built in a new folder.

    Raises CalledProcessError if it does not compile.
    """
    folder.mkdir()
    sources = [source for name in SOURCES for source in (ROOT / "native" / "src").glob(f"{name}.cpp")]
    sources.append(ROOT / "native" / "check" / "codec_bytes.cpp")

    def compile_one(source: Path) -> Path:
        made = folder / f"{source.parent.name}-{source.stem}.o"
        subprocess.run([way.compiler, *way.options, *FLAGS, "-c", source, "-o", made], check=True)
        return made

    with ThreadPoolExecutor(jobs) as pool:
        objects = list(pool.map(compile_one, sources))
    program = folder / "codec_bytes"
    subprocess.run([way.compiler, *way.options, *objects, "-o", program], check=True)
    return program


def hashes(program: Path, columns: int, runner: tuple[str, ...] = ()) -> dict[str, str]:
    """What the program printed: of each kind of bytes its hash.

    Raises CalledProcessError if what it decoded was not what it coded.
    """
    done = subprocess.run([*runner, program, str(columns)], check=True, capture_output=True, text=True)
    return dict(line.rsplit(" ", 1) for line in done.stdout.splitlines())


def by_kind(found: dict[str, str]) -> dict[str, set[str]]:
    """Hashes by what was coded; more than one where the paths of one program differ."""
    kinds: dict[str, set[str]] = {}
    for name, value in found.items():
        kinds.setdefault(name.rpartition(", ")[0] or name, set()).add(value)
    return kinds


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--columns", type=int, default=300)
    parser.add_argument("--only", default="", help="ways whose name contains this")
    chosen = parser.parse_args()
    first: dict[str, set[str]] = {}
    different = 0
    for number, way in enumerate(way for way in builds() if chosen.only in str(way)):
        if way.missing:
            print(f"{way!s:52} left out: no {way.missing} here", flush=True)
            continue
        with tempfile.TemporaryDirectory() as folder:
            program = build(way, Path(folder) / f"build-{number}")
            found = hashes(program, chosen.columns, way.runner)
        kinds = by_kind(found)
        first = first or kinds
        same = kinds == first and all(len(values) == 1 for values in kinds.values())
        different += not same
        tried = [name.rpartition(", ")[2] for name in found if name.startswith(("ranges, ", "networks, "))]
        print(f"{way!s:52} {', '.join(tried):60} {'the same' if same else f'DIFFERENT: {kinds}'}", flush=True)
    for kind, values in first.items():
        print(f"  {kind:20} {' '.join(sorted(values))}")
    return 1 if different else 0


if __name__ == "__main__":
    sys.exit(main())
