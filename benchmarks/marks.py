"""Puts what a benchmark prints between its marks in a page of the documentation."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple


class Marks(NamedTuple):
    """Lines of a page between which a benchmark writes."""

    begin: str
    end: str

    def write(self, page: Path, text: str) -> None:
        """Put the text between the marks of a page; leaves with a sentence, and the page as it was, if it has none."""
        before, begin, rest = page.read_text().partition(self.begin)
        _, end, after = rest.partition(self.end)
        if not (begin and end):
            raise SystemExit(f"{page} has no marks {self.begin} and {self.end}")
        page.write_text(f"{before}{self.begin}\n\n{text}\n\n{self.end}{after}")
