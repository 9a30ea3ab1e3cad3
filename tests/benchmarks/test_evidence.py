"""Figures of the documents are those of the result files, and nobody types one."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from benchmarks.evidence import (
    GUIDE,
    GUIDE_MARKS,
    MARKS,
    PAGE,
    README,
    TEMPLATE,
    page,
    table_of_readme,
    tables_of_guide,
)
from benchmarks.results import FIELDS, FOLDER, Result, from_markdown, parse, read, write

FILES = sorted(FOLDER.rglob("*.csv"))


def test_the_page_is_what_the_program_writes() -> None:
    assert PAGE.read_text() == page(), "make evidence writes it"


def test_the_table_of_the_readme_is_what_the_program_writes() -> None:
    assert MARKS.read(README) == table_of_readme(), "make evidence writes it"


def test_the_tables_of_the_guide_are_what_the_program_writes() -> None:
    assert GUIDE_MARKS.read(GUIDE) == tables_of_guide(), "make evidence writes it"


def test_the_prose_is_short_and_measured_figures_come_from_files() -> None:
    prose = TEMPLATE.read_text()
    lines = [line for line in prose.splitlines() if line and not line.startswith(("#", "{", "|"))]
    assert len(lines) <= 150
    results = prose.partition("\n## Headline")[2].partition("\n## What the figures mean")[0]
    results += prose.partition("\n## Results")[2]
    typed = re.sub(r"\{[^}]*\}|`[^`]*`|\([^)]*\)", "", results)
    assert re.findall(r"\d+\.\d+|\d+ (?:%|per cent)", typed) == []


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(FOLDER)))
def test_a_result_says_on_what_it_was_measured_and_by_what(path: Path) -> None:
    result = parse(path.read_text())
    assert set(FIELDS) - set(result.fields) <= {"about", "commit"}
    assert {len(row) for row in result.rows} == {len(result.columns)}


def test_a_table_of_a_program_comes_back_from_its_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("benchmarks.results.FOLDER", tmp_path)
    text = "#### A drive\n\n2 frames.\n\n| coder | bits |\n|---|---:|\n| `a` | **1.5** |\n| `b` | 1,024 |\n"
    given = from_markdown(text, {"command": "python -m x", "machine": "m", "date": "2026-01-01"})
    write("some/drive", given)
    assert read("some/drive") == given
    assert given.fields["title"] == "A drive"
    assert given.cell("a", "bits") == "1.5"
    assert given.markdown().splitlines() == ["| coder | bits |", "| --- | ---: |", "| `a` | 1.5 |", "| `b` | 1,024 |"]
    with pytest.raises(KeyError, match="no 'c' with 'bits'"):
        Result.cell(given, "c", "bits")
