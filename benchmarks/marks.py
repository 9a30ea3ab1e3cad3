"""Puts what a benchmark prints between its marks in a page of the documentation."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple


class Marks(NamedTuple):
    """Lines of a page between which a benchmark writes."""

    begin: str
    end: str

    def read(self, page: Path) -> str:
        """What stands between the marks of a page; leaves with a sentence if it has none."""
        return self._parts(page)[1]

    def write(self, page: Path, text: str) -> None:
        """Put the text between the marks of a page; leaves with a sentence, and the page as it was, if it has none."""
        before, _, after = self._parts(page)
        page.write_text(f"{before}{self.begin}\n\n{text}\n\n{self.end}{after}")

    def _parts(self, page: Path) -> tuple[str, str, str]:
        """Before the first mark, between both, and after the second."""
        before, begin, rest = page.read_text().partition(self.begin)
        between, end, after = rest.partition(self.end)
        if not (begin and end):
            raise SystemExit(f"{page} has no marks {self.begin} and {self.end}")
        return before, between.strip(), after
