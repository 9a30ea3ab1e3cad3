"""Writes docs/evaluation.md from evidence.md and the files in results/, and tables of README.md and of a guide.

    python -m benchmarks.evidence

evidence.md is the prose of the page. What stands in braces there comes from result files:

    {table NAME}                          a result: title, what of, program, machine and date, table
    {tables FOLDER}                       all results of a folder
    {curves}                              tables and pictures at equal error
    {cell NAME; ROW; COLUMN}              a figure
    {less NAME; ROW; OTHER; COLUMN}       how many per cent less a row has than another
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Final

from benchmarks import curve_tables
from benchmarks.marks import Marks
from benchmarks.results import FOLDER, Result, names, read

ROOT: Final = Path(__file__).resolve().parents[1]
TEMPLATE: Final = Path(__file__).with_name("evidence.md")
PAGE: Final = ROOT / "docs" / "evaluation.md"
README: Final = ROOT / "README.md"
MARKS: Final = Marks("<!-- figures: make evidence -->", "<!-- end of figures -->")
GUIDE: Final = ROOT / "docs" / "guides" / "archive.md"
GUIDE_MARKS: Final = Marks("<!-- cost: make evidence -->", "<!-- end of cost -->")
SHOWN: Final = (
    ("xz 6, bare packets", "xz over the bare packets", "packets identical"),
    ("pcodec", "`pcodec`, the default, lossless", "packets identical"),
    ("riddle", "`riddle`, the smallest, lossless", "packets identical"),
    ("pcodec max_error_m=0.01", "`pcodec`, `max_error_m=0.01`", "no range off by more than 1 cm"),
    ("riddle max_error_m=0.01", "`riddle`, `max_error_m=0.01`", "no range off by more than 1 cm"),
)
"""Rows of the table of README.md: their names in results/codecs, their names there, and what is kept."""


def shown(result: Result) -> str:
    """A result with its title, what it is of, where it was measured, and its table."""
    heads = [f"#### {result.fields['title']}", result.fields.get("about", ""), result.where(), result.markdown()]
    return "\n\n".join(filter(None, heads))


def curves() -> str:
    """Tables and pictures at equal error, with where they were measured."""
    found = json.loads((FOLDER / "curves.json").read_text())
    return f"{Result(found, [], []).where()}\n\n{curve_tables.text(found['scenes'])}"


def less(name: str, row: str, other: str, column: str) -> str:
    """How many per cent less a row has than another."""
    one, base = (float(read(name).cell(which, column)) for which in (row, other))
    return f"{100 * (1 - one / base):.0f} %"


def filled_in(found: re.Match[str]) -> str:
    """What stands for the words in a pair of braces."""
    word, _, rest = found[1].partition(" ")
    given = [part.strip() for part in rest.split(";")]
    if word == "table":
        return shown(read(*given))
    if word == "tables":
        return "\n\n".join(shown(read(name)) for name in names(*given))
    if word == "cell":
        return read(given[0]).cell(*given[1:])
    if word == "less":
        return less(*given)
    if word == "curves":
        return curves()
    raise ValueError(f"{TEMPLATE.name} has {found[0]}, which no result answers")


def page() -> str:
    """The text of docs/evaluation.md."""
    return re.sub(r"\{(\w[^{}\n]*)\}", filled_in, TEMPLATE.read_text())


def table_of_readme() -> str:
    """The table of README.md."""
    result = read("codecs/singles")
    lines = ["| | geometry | intensity | total | ratio | kbit/s at 10 Hz | |", "|---|---:|---:|---:|---:|---:|---|"]
    for row, name, kept in SHOWN:
        cells = [result.cell(row, column) for column in ("geometry", "intensity", "total", "ratio", "kbit/s")]
        cells = ["" if cell == "-" else cell for cell in cells]
        cells[3:4] = [f"{cells[3]} : 1"]
        lines.append(f"| {name} | {' | '.join(cells)} | {kept} |")
    return "\n".join(lines)


def tables_of_guide() -> str:
    """The tables of the guide to an archive: a month of a fleet, and what was measured of large archives."""
    found = [read(f"archive/{name}") for name in ("month", "measures")]
    return "\n\n".join(f"{one.fields['about']}\n\n{one.markdown()}\n\n{one.where()}" for one in found)


def main() -> int:
    """Write all of them."""
    PAGE.write_text(page())
    MARKS.write(README, table_of_readme())
    GUIDE_MARKS.write(GUIDE, tables_of_guide())
    return 0


if __name__ == "__main__":
    sys.exit(main())
