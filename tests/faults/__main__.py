"""Runs the faults, prints one line of JSON for each, and writes the table.

    python -m tests.faults [ROW ...] [--write docs/operations.md]

Exit code 1 if something happened that must not.
"""

from __future__ import annotations

import argparse
import importlib
import json
import sys
import time
from pathlib import Path

from tests.faults import ROWS
from tests.faults.outcome import Outcome

BEGIN, END = "<!-- faults: begin -->\n", "<!-- faults: end -->\n"
HEAD = "| fault | longest time without a frame | lost | reported |\n|---|---|---|---|\n"


def line(outcome: Outcome) -> str:
    """An outcome as a line of the table."""
    step = "-" if outcome.outage_s is None else f"{outcome.outage_s:.2g} s"
    more = f"; {outcome.figures['note']}" if "note" in outcome.figures else ""
    return f"| {outcome.fault} | {step}{more} | {outcome.lost} | {outcome.reported} |\n"


def written(text: str, outcomes: list[Outcome]) -> str:
    """A page with its table replaced.

    Raises ValueError when the page has no place for it.
    """
    head, begin, rest = text.partition(BEGIN)
    _, end, tail = rest.partition(END)
    if not begin or not end:
        raise ValueError("the page has no place for the table")
    return head + begin + "\n" + HEAD + "".join(map(line, outcomes)) + "\n" + end + tail


def run(name: str) -> Outcome:
    """Run one row; a failure to run it is something that must not have happened."""
    try:
        return importlib.import_module(f"tests.faults.{name}").run()
    except Exception as error:
        return Outcome(name, None, "?", "?", {}, [f"{type(error).__name__}: {error}"])


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.faults", description=__doc__)
    parser.add_argument("rows", nargs="*", metavar="ROW", help=", ".join(ROWS))
    parser.add_argument("--write", type=Path, metavar="PAGE")
    chosen = parser.parse_args()
    if unknown := set(chosen.rows) - set(ROWS):
        parser.error(f"no such row: {', '.join(sorted(unknown))}")
    outcomes = []
    for name in chosen.rows or ROWS:
        begin = time.monotonic()
        outcome = run(name)
        outcomes.append(outcome)
        print(json.dumps(outcome.as_json() | {"row": name, "seconds": round(time.monotonic() - begin, 1)}), flush=True)
    wrong = [f"{outcome.fault}: {text}" for outcome in outcomes for text in outcome.wrong]
    for text in wrong:
        print(f"WRONG: {text}", flush=True)
    if chosen.write is not None and not chosen.rows and not wrong:
        chosen.write.write_text(written(chosen.write.read_text(), outcomes))
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
