"""Runs sweeps, each in a process of its own that has the shim."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from typing import Any

from tests.failing import shim


def swept(row: str, kind: shim.Kind, at_most: int | None = None) -> list[dict[str, Any]]:
    """What came of a row (`sweep.sweep`), of disks twice. at_most: so many n instead of every one."""
    words = [sys.executable, "-m", "tests.failing.sweep", row, kind.name.lower()]
    words += ["--at-most", str(at_most)] if at_most else []
    given = {"LD_PRELOAD": str(shim.built()), "OPENBLAS_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(words, check=False, env=os.environ | given, cwd=shim.ROOT, capture_output=True, text=True)
    if done.returncode:
        return [{"row": row, "wrong": [f"the sweep itself ended with {done.returncode}: {done.stderr[-2000:]}"]}]
    return [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
