"""What the native decoder knows of sensors is what the package knows."""

from __future__ import annotations

import runpy

from tests.conftest import ROOT


def test_the_tables_of_models_are_those_of_the_package() -> None:
    tool = runpy.run_path(str(ROOT / "tools/sensor_tables.py"))
    written = (ROOT / "native/src/sensors/model_tables.cpp").read_text()
    assert "".join(written.split()) == "".join(tool["text"]().split()), "make tables"
