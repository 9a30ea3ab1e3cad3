"""`make bench`: sizes and times of every scene, the publisher's memory, and a line in history/<machine>.jsonl.

python -m benchmarks.run [--scene NAME]... [--dry-run] [--no-memory]
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import re
import resource
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from benchmarks.memory import publisher_memory
from benchmarks.scenes import HERE, Scene, scenes, settings
from benchmarks.stages import stage_times
from lidarcodec.evaluation.bench import bench
from lidarcodec.evaluation.report import label, text_table

BUDGET_MS = {"assembly": 3.0, "whole encode": 12.0, "whole decode": 12.0}
"""What a frame may take on one core."""
MEMORY_BUDGET_MIB = 250


def machine() -> str:
    """A name for this kind of machine: processor and number of cores.

    Where a name tells no generation, as those of virtual machines often do not, family and model do.
    """
    try:
        lines = [line.partition(":") for line in Path("/proc/cpuinfo").read_text().splitlines()]
    except OSError:
        lines = []
    told = {key.strip(): value.strip() for key, _, value in reversed(lines)}
    model = told.get("model name") or platform.processor() or platform.machine()
    if not re.search(r"\d", model):
        model = " ".join([model, *(told[key] for key in ("cpu family", "model") if key in told)])
    words = re.sub(r"\((R|TM)\)|CPU|Processor|@.*", " ", model, flags=re.IGNORECASE)
    return re.sub(r"[^a-z0-9]+", "-", f"{words} {os.cpu_count()} cores".lower()).strip("-")


def history_file() -> Path:
    """Where this machine's lines are kept."""
    return HERE / "history" / f"{machine()}.jsonl"


def _commit() -> str:
    def git(*words: str) -> str:
        return subprocess.run(["git", *words], cwd=HERE, capture_output=True, text=True, check=False).stdout.strip()

    return (git("rev-parse", "--short=12", "HEAD") or "unknown") + ("-dirty" if git("status", "--porcelain") else "")


def _results(scene: Scene) -> list[dict[str, Any]]:
    found = []
    for setting in settings():
        result = bench(scene.spec, setting, frames=scene.frames, calibration=scene.calibration)
        found.append(result | {"source": scene.name})
    return found


def measure(wanted: list[str], memory: bool = True) -> dict[str, Any]:
    """Everything that is measured, as one line of history."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})  # one core: nothing hides behind threads
    found, missing = scenes()
    line: dict[str, Any] = {
        "commit": _commit(),
        "date": f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}",
        "machine": machine(),
        "python": platform.python_version(),
        "missing": missing,
        "scenes": {},
    }
    for text in missing:
        print(f"not measured: {text}", file=sys.stderr)
    for scene in found:
        if wanted and scene.name not in wanted:
            continue
        results = _results(scene)
        print(text_table(results), end="\n\n", flush=True)
        stages = stage_times(scene)
        print(_stages_text(scene, stages), end="\n\n", flush=True)
        line["scenes"][scene.name] = {
            "data": scene.data_hash,
            "stages_ms": stages,
            "codecs": {label(result): _kept(result) for result in results},
        }
    line["peak_memory_mib"] = round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, 1)
    if memory:
        line["publisher_memory_mib"] = publisher_memory()
        print(f"publisher: {line['publisher_memory_mib']} MiB (budget {MEMORY_BUDGET_MIB})")
    return line


def _kept(result: dict[str, Any]) -> dict[str, Any]:
    names = ("settings", "frames", "bits_per_point", "ratio", "kbps_at_10hz", "max_error_m", "packets_identical",
             "encode_ms", "decode_ms")  # fmt: skip
    return {name: result[name] for name in names}


def _stages_text(scene: Scene, stages: dict[str, float]) -> str:
    lines = [f"{scene.name}: milliseconds of one core a frame of 348 packets, lossless pcodec"]
    for stage, ms in stages.items():
        budget = BUDGET_MS.get(stage)
        note = "" if budget is None else f"  (budget {budget:g}{', OVER' if ms > budget else ''})"
        lines.append(f"  {stage:<18}{ms:8.2f}{note}")
    other = stages["velodyne-decoder"]
    whole, assembly = stages["whole encode"] / other, stages["assembly"] / other
    lines.append(f"  velodyne-decoder, to a cloud: 1; our whole encoding: {whole:.2f}; our assembly: {assembly:.2f}")
    return "\n".join(lines)


def main() -> int:
    """Measure, print, and add to the history."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.run", description=__doc__)
    parser.add_argument("--scene", action="append", default=[], help="only this one; repeatable")
    parser.add_argument("--dry-run", action="store_true", help="measure, and leave the history as it is")
    parser.add_argument("--no-memory", action="store_true", help="leave out the publisher's memory (a minute)")
    chosen = parser.parse_args()
    line = measure(chosen.scene, memory=not chosen.no_memory)
    if not chosen.dry_run:
        path = history_file()
        path.parent.mkdir(exist_ok=True)
        with path.open("a") as file:
            file.write(json.dumps(line, separators=(",", ":")) + "\n")
        print(f"added to {path.relative_to(HERE.parent)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
