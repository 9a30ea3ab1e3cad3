"""How soon the page of a demonstration shows its first points, stage by stage.

    python -m benchmarks.first_picture [--rounds 5] [--cold] [--dry-run]

What `make demo` does once its set-up is there: the process starts, its server says where the page is, a headless
Chromium opens that address, and the title counts points. Chromium runs already, as on a machine where somebody works,
or with `--cold` it is started with the address, as a demonstration would start it. Processor time is that of the
demonstration's processes until the picture, which a busy machine does not change by much. A line goes to
history/page-<machine>.jsonl.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from datetime import UTC, datetime
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks.page import FLAGS
from benchmarks.run import _commit, machine
from benchmarks.scenes import HERE

STAGES = ("address", "page", "points")
"""The address is told; the page's files are there; points are drawn. Seconds from the start of the process."""
LIMIT_S = 120.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--cold", action="store_true", help="start Chromium only when there is an address")
    parser.add_argument("--dry-run", action="store_true", help="measure, and leave the history as it is")
    options = parser.parse_args()
    from playwright.sync_api import sync_playwright

    program = shutil.which("chromium")
    if program is None:
        raise SystemExit("needs chromium")
    rounds: list[dict[str, float]] = []
    with sync_playwright() as playwright:

        def launch() -> Any:
            return playwright.chromium.launch(executable_path=program, args=FLAGS)

        print("round  address   page  points   processor, s   load")
        for number in range(options.rounds):
            found = measure(launch, cold=options.cold)
            rounds.append(found)
            stages = "  ".join(f"{found[stage]:6.2f}" for stage in STAGES)
            print(f"{number + 1:5}  {stages}   {found['processor']:10.2f}   {found['load']:6.1f}", flush=True)
    line = {"commit": _commit(), "date": f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}", "machine": machine()}
    line |= {"what": "first picture, s", "browser": "cold" if options.cold else "warm", "rounds": len(rounds)}
    line |= {name: round(median(one[name] for one in rounds), 2) for name in rounds[0]}
    line |= {"best": round(min(one["points"] for one in rounds), 2)}
    print(json.dumps(line))
    if not options.dry_run:
        with (HERE / "history" / f"page-{machine()}.jsonl").open("a") as history:
            history.write(json.dumps(line, separators=(",", ":")) + "\n")


def measure(launch: Any, *, cold: bool) -> dict[str, float]:
    """One start: its stages, the processor time until the picture, and the load of the machine before it."""
    browser = None if cold else launch()
    context = browser.new_context() if browser else None
    load = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as folder:
        start = time.monotonic()
        command = [sys.executable, "-m", "lidarcodec", "demo", "--no-browser", "--seconds", "100"]
        here = dict(os.environ, PYTHONPATH=os.pathsep.join(str(HERE.parent / part) for part in ("", "server")))
        demo = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, env=here)
        try:
            assert demo.stdout is not None
            said = re.search(rb"http://\S+", demo.stdout.readline())
            if said is None:
                raise SystemExit("the demonstration did not start")
            stages = {"address": time.monotonic() - start}
            browser = browser or launch()
            page = (context or browser.new_context()).new_page()
            page.goto(said[0].decode(), wait_until="commit")
            stages["page"] = time.monotonic() - start
            while "points" not in page.title():
                if time.monotonic() - start > LIMIT_S:
                    raise SystemExit("no points came")
                time.sleep(0.01)
            stages["points"] = time.monotonic() - start
            used = sum(map(_processor_s, [demo.pid, *_children(demo.pid)]))
        finally:
            demo.terminate()
            demo.communicate()
            if browser is not None:
                browser.close()
    return stages | {"processor": used, "load": load}


def _children(process: int) -> list[int]:
    return [int(one) for one in Path(f"/proc/{process}/task/{process}/children").read_text().split()]


def _processor_s(process: int) -> float:
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


if __name__ == "__main__":
    main()
