"""Builds the images in a chroot, runs them together, and writes what was seen.

    python -m tests.images [--folder DIR] [--write docs/images.md]

Needs root, debootstrap, util-linux, a way to the registries of pip and apt, PostgreSQL's server, and Prometheus, if it
is to be tried too. Takes 3 GB in a folder that is removed at the end. One that was given stays, and a stage that it has
is not built again unless its text changed: for work on what comes after it.
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from tests.images.dockerfile import DOCKERFILE, ROOT, parse
from tests.images.stages import Builder

BEGIN, END = "<!-- images: begin -->\n", "<!-- images: end -->\n"


def build(folder: Path) -> dict[str, Any]:
    """All stages; what each took."""
    builder, found = Builder(folder), {}
    for stage in parse(DOCKERFILE.read_text()):
        built = builder.build(stage)
        steps = [f"{one['step']} of line {one['line']}" for one in built.steps]
        found[stage.name] = {
            "steps": steps, "seconds": round(sum(one["seconds"] for one in built.steps)),
            "added MB": round(built.added_bytes / 1e6),
        }  # fmt: skip
        print(json.dumps({stage.name: found[stage.name]}), flush=True)
    text = json.dumps([one.as_json() for one in builder.built.values()])
    (folder / "built.json").write_text(text)
    return found


def meet(folder: Path) -> dict[str, Any]:
    """Run them together, on a network of their own.

    Raises subprocess.CalledProcessError when something happened that must not.
    """
    words = ["unshare", "--net", sys.executable, "-m", "tests.images.scenario", folder]
    done = subprocess.run(words, check=True, stdout=subprocess.PIPE, text=True, cwd=ROOT)
    return dict(json.loads(done.stdout))


def page(stages: dict[str, Any], seen: dict[str, Any]) -> str:
    """As the table of docs/images.md."""
    today = datetime.date.today().isoformat()
    lines = [f"Run on {today}.", "", "| stage | steps that were run | s | adds, MB |", "|---|---|---:|---:|"]
    for name, one in stages.items():
        kinds = [step.split()[0] for step in one["steps"]]
        run = ", ".join(f"{kinds.count(kind)} {kind}" for kind in ("RUN", "COPY") if kind in kinds)
        lines.append(f"| `{name}` | {run} | {one['seconds']} | {one['added MB']} |")
    lines += ["", "| seen | |", "|---|---|"]
    for name, value in seen.items():
        text = f"{value[0]}, {value[1]}" if isinstance(value, list | tuple) else str(value)
        lines.append(f"| {name} | {text.replace('|', '/')} |")
    return "\n".join(lines) + "\n"


def written(text: str, inside: str) -> str:
    """A page with what stands between the marks replaced.

    Raises ValueError when it has none.
    """
    head, begin, rest = text.partition(BEGIN)
    _, end, tail = rest.partition(END)
    if not begin or not end:
        raise ValueError("the page has no place for it")
    return head + begin + "\n" + inside + "\n" + end + tail


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.images", description=__doc__)
    parser.add_argument("--folder", type=Path, metavar="DIR")
    parser.add_argument("--write", type=Path, metavar="PAGE")
    chosen = parser.parse_args()
    missing = [name for name in ("debootstrap", "unshare", "nsenter", "setpriv") if shutil.which(name) is None]
    if os.geteuid() != 0 or missing:
        parser.error(f"needs root{', and ' + ', '.join(missing) if missing else ''}")
    folder = chosen.folder or Path(tempfile.mkdtemp(prefix="images-"))
    folder.mkdir(exist_ok=True)
    try:
        stages = build(folder)
        seen = meet(folder)
        print(json.dumps(seen), flush=True)
        if chosen.write is not None:
            chosen.write.write_text(written(chosen.write.read_text(), page(stages, seen)))
    finally:
        if chosen.folder is None:
            shutil.rmtree(folder)
    return 0


if __name__ == "__main__":
    sys.exit(main())
