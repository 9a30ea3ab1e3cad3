"""What a user loses if these fail: to know where the time of `predictive` and `riddle` goes.

The program that measures it is built from the core's own headers, and by nothing else: a change there would break it in
silence.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys

import pytest

from benchmarks.range_stages import COMPILER, CORE, ROOT, networks, processors
from benchmarks.scenes import HERE

WORDS = ["--dry-run", "--frames", "2", "--rounds", "1", "--source", "sim:street?seed=1&frames=2", "--thin", "32"]
STAGES = ("canvas", "contexts", "sums", "learning", "coder and offsets", "whole")


def _history() -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in (HERE / "history").iterdir()}


@pytest.mark.sweep
@pytest.mark.timeout(300)
def test_every_stage_of_every_codec_is_measured_on_a_small_turn() -> None:
    if not shutil.which(COMPILER) or not CORE.exists():
        pytest.skip(f"needs the compiler {COMPILER} and {CORE.relative_to(ROOT)}, which `make native` builds")
    before = _history()
    words = [sys.executable, "-m", "benchmarks.predictive_stages", *WORDS, "--unoptimised"]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(str(ROOT / folder) for folder in ("", "server"))}
    done = subprocess.run(words, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert _history() == before
    lines = [line.strip() for line in done.stdout.splitlines()]
    best = str(processors()[-1])
    for codec, nets in networks().items():
        where = next(name for name in map(str, reversed(processors())) if f"{name}: {codec}" in lines)
        assert where == best or not nets
        at = lines.index(f"{where}: {codec}")
        for line in lines[at + 1 : at + 5]:
            stages = (*STAGES, "inputs", "network") if nets else STAGES
            assert line.startswith(("encode", "decode"))
            assert all(f"{stage} " in line for stage in stages), line
    assert any(line.startswith("thread scaling") for line in lines)
