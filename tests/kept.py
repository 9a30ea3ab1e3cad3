"""What tests compile of the core, kept in build/tests: nothing has to be compiled twice of the same sources."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from hashlib import sha256
from pathlib import Path

ROOT = Path(__file__).parents[1]
KEPT = ROOT / "build" / "tests"


def kept(name: str, compiler: str, options: Sequence[str], make: Callable[[Path], Path]) -> Path:
    """The file that `make` compiles in a new folder; that of an earlier run if compiler, options and sources are alike.

    Not for options that ask for the processor at hand: a folder may come to another one.
    """
    found = KEPT / name / _fingerprint(compiler, options)
    if not found.exists():
        KEPT.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=KEPT) as folder:
            made = make(Path(folder) / "build")
            shutil.rmtree(found.parent, ignore_errors=True)  # of other sources
            found.parent.mkdir(exist_ok=True)
            made.replace(found)  # at once: two runs may make the same
    return found


def _fingerprint(compiler: str, options: Sequence[str]) -> str:
    version = subprocess.run([compiler, "--version"], check=True, capture_output=True).stdout
    digest = sha256(version + repr((compiler, *options)).encode())
    for source in sorted((ROOT / "native").glob("[sc]*/**/*.?pp")):
        data = source.read_bytes()
        digest.update(f"\n{source.relative_to(ROOT)} {len(data)}\n".encode() + data)
    return digest.hexdigest()[:32]
