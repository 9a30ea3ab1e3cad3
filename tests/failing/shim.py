"""The library that makes calls fail (shim.cpp): built once, loaded with LD_PRELOAD, and used from Python."""

from __future__ import annotations

import ctypes
import hashlib
import os
import shutil
import subprocess
from enum import IntEnum
from functools import cache
from pathlib import Path

SOURCE = Path(__file__).with_name("shim.cpp")
ROOT = SOURCE.parents[2]


class Kind(IntEnum):
    """What fails: calls that change a disk, `operator new` of the native core, memory in parts of 64 KiB and more."""

    DISK = 1
    CORE = 2
    LARGE = 3


def compiler() -> str | None:
    """The C++ compiler at hand."""
    return next(filter(None, map(shutil.which, (os.environ.get("CXX", "c++"), "g++", "clang++"))), None)


def built() -> Path:
    """The library, compiled unless it is there already.

    Raises subprocess.CalledProcessError.
    """
    name = hashlib.sha256(SOURCE.read_bytes()).hexdigest()[:16]
    made = ROOT / "build" / "tests" / f"failing-{name}.so"
    if not made.exists():
        made.parent.mkdir(parents=True, exist_ok=True)
        beside = made.with_suffix(f".{os.getpid()}")
        given = ["-std=c++20", "-O1", "-fPIC", "-shared", "-o", str(beside), str(SOURCE), "-ldl"]
        subprocess.run([compiler() or "c++", *given], check=True)
        beside.replace(made)
    return made


@cache
def _library() -> ctypes.CDLL:
    return ctypes.CDLL(None)  # what LD_PRELOAD brought


def arm(kind: Kind, number: int, *, goes_on: bool) -> None:
    """From now on the call of this number fails, and with `goes_on` all after it. 0: none fails, they are counted."""
    _library().fail_arm(int(kind), ctypes.c_long(number), int(goes_on))


def disarm() -> int:
    """Nothing fails any more; calls of the kind since `arm`."""
    library = _library()
    library.fail_disarm.restype = ctypes.c_long
    return int(library.fail_disarm())
