"""What a reader loses if these fail: a notebook that does not run, or shows what it no longer gives."""

from __future__ import annotations

import pytest

from tests.command_line import environment
from tests.transport.conftest import free_port
from tools import notebooks

SLOW = {"training", "bits-and-error", "live"}


def here(name):
    marks = [pytest.mark.sweep, pytest.mark.timeout(900)] if name in SLOW else []
    return pytest.param(name, marks=marks)


@pytest.mark.parametrize("name", [here(name) for name in notebooks.names()])
def test_a_notebook_runs_and_prints_what_stands_in_it(name, monkeypatch):
    pytest.importorskip("matplotlib")
    if name == "training":
        pytest.importorskip("torch")
    for variable in ("PYTHONPATH", "OPENBLAS_NUM_THREADS"):
        monkeypatch.setenv(variable, environment()[variable])
    monkeypatch.setenv("LIDARCODEC_LOOPBACK_PORT", str(free_port()))
    written = notebooks.read(name)
    found = list(notebooks.ran(written, name))
    for cell, text, figures in found:
        assert len(figures) == len(notebooks.figures_in(cell)), "".join(cell["source"])
        if not {"times", "training"} & {name, *cell["metadata"].get("tags", [])}:
            assert text == notebooks.printed_in(cell)
    assert len(found) == len(notebooks.code_cells(written))
