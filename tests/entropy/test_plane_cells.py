"""What cells of planes begin with is one table, in the native core and on the page."""

from __future__ import annotations

import re

from tests.reference.plane_rows import FIRST_CELLS, PAGE


def test_the_core_has_the_table_of_the_page() -> None:
    header = (PAGE.parents[1] / "native/src/images/first_cells.hpp").read_text()
    table = header.partition("kFirstBeside = {")[2].partition("}")[0]
    numbers = [256 * int(number) for number in re.findall(r"-?\d+", table)]
    assert numbers == [number for row in FIRST_CELLS for number in row]
    assert len(FIRST_CELLS) == 13 * 13
