"""Files of measured figures: a table in CSV below lines that say on what, by what and when it was measured.

    # title: KITTI raw, drive 0005
    # about: 19 frames, 118,336 returns each.
    # machine: AMD EPYC (Zen 4), two shared cores
    # date: 2026-11-23
    # commit: 2c9e424
    # command: python -m benchmarks.range_table --drives 0005 --save
    coder,lossless,1 cm

Programs with `--save` write them into benchmarks/results/, and `python -m benchmarks.evidence` makes pages of them.
"""

from __future__ import annotations

import csv
import datetime
import io
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Final, NamedTuple

FOLDER: Final = Path(__file__).resolve().parent / "results"
FIELDS: Final = ("title", "about", "machine", "date", "commit", "command")
_NUMBERS: Final = re.compile(r"[-+]?[\d.,]*( %)?( / [-+]?[\d.,]+)*|-")


class Result(NamedTuple):
    """A table of text cells. fields: those of FIELDS that are known."""

    fields: dict[str, str]
    columns: list[str]
    rows: list[list[str]]

    def cell(self, row: str, column: str) -> str:
        """The cell of a row, named by its first cell without backticks, in a column.

        Raises KeyError, naming both, where there is none.
        """
        for cells in self.rows:
            if cells[0].replace("`", "") == row and column in self.columns:
                return cells[self.columns.index(column)]
        raise KeyError(f"{self.fields.get('title')}: no {row!r} with {column!r}")

    def markdown(self) -> str:
        """The table alone; columns of numbers stand at the right."""
        right = [at > 0 and all(_NUMBERS.fullmatch(row[at]) for row in self.rows) for at in range(len(self.columns))]
        lines = [self.columns, ["---:" if one else "---" for one in right], *self.rows]
        return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)

    def where(self) -> str:
        """A line: program, machine, date and commit."""
        parts = [self.fields[name] for name in ("machine", "date") if self.fields.get(name)]
        if self.fields.get("commit"):
            parts.append(f"commit `{self.fields['commit']}`")
        return f"`{self.fields['command']}`; {', '.join(parts)}."


def parse(text: str) -> Result:
    """A file's text as a result."""
    lines = text.splitlines()
    heads = [line.removeprefix("# ").partition(": ") for line in lines if line.startswith("# ")]
    table = list(csv.reader(line for line in lines if not line.startswith("# ")))
    return Result({name: value for name, _, value in heads}, table[0], table[1:])


def read(name: str) -> Result:
    """The result of a name such as `ranges/0005`."""
    return parse((FOLDER / f"{name}.csv").read_text())


def names(folder: str) -> list[str]:
    """All results of a folder, in alphabetical order."""
    return sorted(f"{folder}/{path.stem}" for path in (FOLDER / folder).glob("*.csv"))


def from_markdown(text: str, fields: dict[str, str]) -> Result:
    """The table of a Markdown text; its heading becomes the title, a sentence above the table says what it is about."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    table = [[cell.strip().strip("*") for cell in line[1:-1].split("|")] for line in lines if line[0] == "|"]
    found = dict(fields)
    for field, marks in (("title", "#"), ("about", "")):
        if said := [line.lstrip("# ") for line in lines if (line[0] == marks if marks else line[0] not in "#|")]:
            found[field] = " ".join(said)
    return Result(found, table[0], table[2:])


def write(name: str, result: Result) -> None:
    """Put a result into its file."""
    path = FOLDER / f"{name}.csv"
    path.parent.mkdir(parents=True, exist_ok=True)
    out = io.StringIO()
    for field in FIELDS:
        if result.fields.get(field):
            out.write(f"# {field}: {result.fields[field]}\n")
    csv.writer(out, lineterminator="\n").writerows([result.columns, *result.rows])
    path.write_text(out.getvalue())


def save(name: str, text: str, **more: str) -> None:
    """Put the Markdown table of a program that runs into a result file, with this machine, day, commit and command."""
    write(name, from_markdown(text, here() | more))


def here() -> dict[str, str]:
    """Machine, date, commit and command of this process."""
    asked = ["git", "rev-parse", "--short", "HEAD"]
    commit = subprocess.run(asked, cwd=FOLDER.parent, capture_output=True, text=True, check=False).stdout.strip()
    program = Path(sys.argv[0]).stem
    return {
        "machine": f"{_processor()}, {os.cpu_count()} cores",
        "date": datetime.datetime.now(tz=datetime.UTC).date().isoformat(),
        "commit": commit,
        "command": " ".join(["python -m", f"benchmarks.{program}", *sys.argv[1:]]),
    }


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    names = re.findall(r"^model name\s*: (.*)$", info.read_text(), flags=re.MULTILINE) if info.exists() else []
    return names[0] if names else "unknown processor"
