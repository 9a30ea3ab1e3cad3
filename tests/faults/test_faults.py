"""The quick ones of `make faults`, and whether the table in the documentation is that of the rows."""

from __future__ import annotations

import importlib

import pytest

from tests.conftest import ROOT
from tests.faults import ROWS
from tests.faults.__main__ import BEGIN, END, written
from tests.faults.disk_full import SmallDisk
from tests.faults.outcome import Outcome

pytestmark = pytest.mark.timeout(100)
PAGE = (ROOT / "docs" / "operations.md").read_text()


def test_every_row_has_its_line_in_the_documentation():
    table = PAGE.partition(BEGIN)[2].partition(END)[0]
    lines = [line for line in table.splitlines() if line.startswith("| ")]
    assert len(lines) == len(ROWS) + 1
    assert "WRONG" not in table
    for name in ROWS:
        assert importlib.import_module(f"tests.faults.{name}").__doc__


def test_a_table_is_written_where_it_belongs_and_nowhere_else():
    new = written(PAGE, [Outcome("a fault", 0.1, "nothing", "nobody", {"note": "more"})])
    assert "| a fault | 0.1 s; more | nothing | nobody |\n" in new
    assert new.partition(BEGIN)[0] == PAGE.partition(BEGIN)[0]
    assert new.partition(END)[2] == PAGE.partition(END)[2]
    with pytest.raises(ValueError, match="no place"):
        written("a page", [])


@pytest.mark.sweep
def test_a_full_disk_stops_the_recording_and_not_the_stream():
    if (why := SmallDisk.missing()) is not None:
        pytest.skip(why)
    from tests.faults import disk_full

    outcome = disk_full.run()
    assert not outcome.wrong
    assert "No space left on device" in outcome.reported


@pytest.mark.sweep
def test_hostile_messages_neither_stop_a_stream_nor_change_it():
    from tests.faults import hostile_zenoh

    assert not hostile_zenoh.run(800).wrong
