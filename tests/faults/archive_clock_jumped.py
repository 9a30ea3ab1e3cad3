"""The clocks of driver and workers are years apart, and jump: no object may depend on the time of day."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from pathlib import Path

from tests import command_line
from tests.faults.archive_killed import objects, undisturbed, words
from tests.faults.outcome import Outcome

CLOCKS = ("-20y", "+10y x50", "-1h x0.2")
"""As of `faketime`: a shift, and how many times as fast the clock goes."""
PATIENCE_S = 300.0


def run() -> Outcome:
    title = "clock of `archive run` years ahead or behind, fast or slow"
    if shutil.which("faketime") is None:
        return Outcome(title, None, "?", "?", {"note": "not run: there is no `faketime`"})
    wrong: list[str] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        expected = undisturbed(folder)
        for number, clock in enumerate(CLOCKS):
            command = ["faketime", "-m", "-f", clock, *command_line.COMMAND, "archive", *words(folder, f"out-{number}")]
            variables = command_line.environment(FAKETIME_DONT_FAKE_MONOTONIC="1")
            done = subprocess.run(
                command, capture_output=True, text=True, env=variables, timeout=PATIENCE_S, check=False
            )
            if done.returncode:
                wrong.append(f"{clock}: {done.stderr[-300:]}")
            elif objects(folder / f"out-{number}") != expected:
                wrong.append(f"{clock}: other objects than with the right clock")
    return Outcome(
        title,
        None,
        "nothing: the same objects, byte for byte",
        "nothing: no object has the time of day",
        {"note": f"clocks {', '.join(CLOCKS)}"},
        wrong,
    )
