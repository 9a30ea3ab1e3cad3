"""Captures of simulated drives, kept in build/tests: to simulate a turn takes 0.1 s of a processor.

For tests that need a drive. Those of `lidarcodec simulate` and of the simulator have it simulate.
"""

from __future__ import annotations

import contextlib
import shutil
import tempfile
from functools import cache
from hashlib import sha256
from pathlib import Path

from tests.command_line import run_here
from tests.kept import KEPT, ROOT


def simulated(source: str, path: Path, *words: object) -> Path:
    """The capture that `lidarcodec simulate` writes, with what it writes beside it. words: further words"""
    name = sha256(repr((source, path.name, *words)).encode()).hexdigest()[:32]
    found = KEPT / "drives" / _fingerprint() / name
    if not found.exists():
        KEPT.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=KEPT) as folder:
            made = Path(folder) / "made"
            made.mkdir()
            ran = run_here("simulate", source, made / path.name, *words)
            assert ran.returncode == 0, ran.stderr
            for old in found.parent.parent.glob("*"):
                if old != found.parent:
                    shutil.rmtree(old, ignore_errors=True)  # of another version of the package
            found.parent.mkdir(parents=True, exist_ok=True)
            with contextlib.suppress(OSError):  # two runs may make the same
                made.replace(found)
    shutil.copytree(found, path.parent, dirs_exist_ok=True)
    return path


@cache
def _fingerprint() -> str:
    """Of all files of the package: another version may simulate otherwise."""
    digest = sha256()
    for path in sorted((ROOT / "lidarcodec").rglob("*")):
        if path.is_file() and path.suffix != ".pyc":
            about = path.stat()
            digest.update(f"{path.relative_to(ROOT)} {about.st_size} {about.st_mtime_ns}\n".encode())
    return digest.hexdigest()[:32]
