"""The clocks of driver and workers are years apart, and jump: no object may depend on the time of day."""

from __future__ import annotations

import subprocess
import tempfile
from pathlib import Path

from tests import command_line
from tests.failing.shim import compiler
from tests.faults.archive_killed import objects, undisturbed, words
from tests.faults.outcome import Outcome

SOURCE = Path(__file__).with_name("other_clock.c")
YEAR_S = 365 * 86400
CLOCKS = {
    "20 years behind": (-20 * YEAR_S, 1, 0),
    "10 years ahead, 50 times as fast": (10 * YEAR_S, 50, 0),
    "an hour behind, a fifth as fast": (-3600, 0.2, 0),
    "an hour ahead and back each second": (0, 1, 3600),
}
"""Seconds ahead, rate, and seconds of the jumps."""
PATIENCE_S = 300.0


def run() -> Outcome:
    title = "clock of `archive run` years ahead or behind, fast or slow, or jumping"
    if (builder := compiler()) is None:
        return Outcome(title, None, "?", "?", {"note": "not run: there is no compiler"})
    wrong: list[str] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        library = folder / "other_clock.so"
        subprocess.run([builder, "-x", "c", "-shared", "-fPIC", "-o", library, SOURCE, "-ldl"], check=True)
        expected = undisturbed(folder)
        for number, (clock, how) in enumerate(CLOCKS.items()):
            other = {"LD_PRELOAD": str(library), "OTHER_CLOCK": "{} {} {}".format(*how)}
            out = f"out-{number}"
            done = command_line.run("archive", *words(folder, out), limit_s=PATIENCE_S, **other)
            if done.returncode:
                wrong.append(f"{clock}: {done.stderr[-300:]}")
            elif objects(folder / out) != expected:
                wrong.append(f"{clock}: other objects than with the right clock")
    return Outcome(
        title,
        None,
        "nothing: the same objects, byte for byte",
        "nothing: no object has the time of day",
        {"note": f"clocks {'; '.join(CLOCKS)}"},
        wrong,
    )
