"""A drive that is measured anew does not cost the page what was measured of the others."""

from __future__ import annotations

from pathlib import Path

from benchmarks.rate_pictures import HEAD, MARKS, table_with

EVALUATION = Path(__file__).parents[2] / "docs/evaluation.md"


def row(drive: str, codec: str, sent: int) -> str:
    return f"| {drive} | `{codec}` | 300 | {sent} | +0.0 % | 0.1 | 0.1 | 0.00 | 70.0 | 0 |"


def test_rows_of_other_drives_and_codecs_stay(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    before = [row("0005", "riddle", 1), row("0005", "jpeg", 2), row("0006", "riddle", 3), row("city", "riddle", 4)]
    page.write_text(f"text\n\n{MARKS.begin}\n\n" + "\n".join([HEAD, *before]) + f"\n\n{MARKS.end}\n\nmore\n")
    measured = {("0006", "riddle"): [row("0006", "riddle", 5)], ("0005", "zstd"): [row("0005", "zstd", 6)]}
    MARKS.write(page, table_with(measured, MARKS.read(page)))
    assert MARKS.read(page).splitlines() == [
        *HEAD.splitlines(),
        row("0005", "riddle", 1),
        row("0005", "jpeg", 2),
        row("0005", "zstd", 6),
        row("0006", "riddle", 5),
        row("city", "riddle", 4),
    ]
    assert page.read_text().startswith("text\n")
    assert page.read_text().endswith(f"{MARKS.end}\n\nmore\n")


def test_where_nothing_is_measured_the_page_keeps_its_table() -> None:
    assert table_with({}, MARKS.read(EVALUATION)) == MARKS.read(EVALUATION)


def test_a_page_without_a_table_gets_one() -> None:
    assert table_with({("0005", "riddle"): ["| row |"]}, "") == f"{HEAD}\n| row |"
