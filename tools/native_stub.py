"""Writes lidarcodec/_native.pyi, the types of the native core, from the built module (nanobind's stubgen).

tools/build-native.sh calls it after each build; tests/test_native_stub.py checks that the committed file is current.
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

STUB = Path(__file__).resolve().parent.parent / "lidarcodec" / "_native.pyi"
HEAD = (
    '"""Types of the native core, by tools/native_stub.py; the docstring of each function is in native/bindings."""\n'
)
ARRAY = re.compile(r"Annotated\[(NDArray\[[\w.]+\]), dict\((?:writable=False|.*?device='cpu'(?:, writable=False)?)\)\]")
ANY_ARRAY = re.compile(r"Annotated\[NDArray, dict\((?:writable=False|.*?device='cpu', writable=False)\)\]")
"""Of unsigned numbers, of 8 to 64 bits."""


def stub() -> str:
    """The text of the stub: without docstrings, and with arrays as their element type alone."""
    from nanobind.stubgen import StubGen

    import lidarcodec._native as module

    generator = StubGen(module, include_docstrings=False, quiet=True)
    generator.put(module)
    text = ARRAY.sub(r"\1", ANY_ARRAY.sub("NDArray[numpy.unsignedinteger]", generator.get()))
    text = re.sub(r"^from typing import Annotated\n", "", text, flags=re.MULTILINE)
    ruff = [sys.executable, "-m", "ruff", "format", "-", "--stdin-filename", str(STUB)]
    return subprocess.run(ruff, input=HEAD + text, capture_output=True, text=True, check=True).stdout


if __name__ == "__main__":
    STUB.write_text(stub())
