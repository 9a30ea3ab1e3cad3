"""`make bench-compare`: this tree against the last entry of the same machine; more than 3 % worse is flagged.

    python -m benchmarks.compare [--scene NAME]...

Sizes are exact, so any growth beyond 3 % is real. Times are medians on a machine that may be busy: look twice.
Exit code 1 if anything is flagged.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from typing import Any

from benchmarks.run import history_file, measure

LIMIT = 0.03


def last_entry() -> dict[str, Any] | None:
    """The newest line of this machine's history."""
    path = history_file()
    if not path.exists():
        return None
    lines = [line for line in path.read_text().splitlines() if line.strip()]
    return json.loads(lines[-1]) if lines else None


def figures(line: dict[str, Any]) -> dict[str, float]:
    """All figures of a line that are better when smaller, by name."""
    found: dict[str, float] = {}
    for name, scene in line["scenes"].items():
        for stage, ms in scene["stages_ms"].items():
            if stage != "velodyne-decoder":
                found[f"{name} / {stage} ms"] = ms
        for codec, result in scene["codecs"].items():
            for plane, bits in result["bits_per_point"].items():
                if bits is not None and plane != "header":
                    found[f"{name} / {codec} / {plane} bits"] = bits
            for way in ("encode_ms", "decode_ms"):
                found[f"{name} / {codec} / {way} p50"] = result[way]["p50"]
    for key in ("peak_memory_mib", "publisher_memory_mib"):
        if line.get(key) is not None:
            found[key] = line[key]
    return found


def changes(before: dict[str, float], now: dict[str, float]) -> Iterator[tuple[str, float, float, float]]:
    """Name, before, now and relative change of every figure that both have."""
    for name in before.keys() & now.keys():
        if before[name]:
            yield name, before[name], now[name], now[name] / before[name] - 1


def main() -> int:
    """Measure, compare, and say what moved."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.compare", description=__doc__)
    parser.add_argument("--scene", action="append", default=[], help="only this one; repeatable")
    chosen = parser.parse_args()
    before = last_entry()
    if before is None:
        print(f"no history of this machine ({history_file().name}): run `make bench` first", file=sys.stderr)
        return 1
    now = measure(chosen.scene, memory=not chosen.scene)
    moved = sorted(changes(figures(before), figures(now)), key=lambda change: -change[3])
    worse = [change for change in moved if change[3] > LIMIT]
    better = [change for change in moved if change[3] < -LIMIT]
    print(f"against {before['commit']} of {before['date']}: {len(worse)} worse, {len(better)} better, of {len(moved)}")
    for mark, group in (("WORSE", worse), ("better", better)):
        for name, old, new, change in group:
            print(f"  {mark:<7}{change:+8.1%}  {old:10.3f} -> {new:10.3f}  {name}")
    return 1 if worse else 0


if __name__ == "__main__":
    sys.exit(main())
