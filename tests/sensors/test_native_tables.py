"""What the native decoder knows of sensors is what the package knows."""

from __future__ import annotations

import runpy

import pytest

from lidarcodec.sensors.models import vlp16
from lidarcodec.sensors.models.velodyne_packet import VelodyneSensor
from tests.conftest import ROOT

TOOL = runpy.run_path(str(ROOT / "tools/sensor_tables.py"))


def test_the_tables_of_models_are_those_of_the_package() -> None:
    written = (ROOT / "native/src/sensors/model_tables.cpp").read_text()
    assert "".join(written.split()) == "".join(TOOL["text"]().split()), "make tables"


def test_a_model_with_code_of_its_own_is_not_taken_for_one_without() -> None:
    class Wobbling(VelodyneSensor):
        """A Velodyne whose points the native decoder would place wrongly."""

    parts = {name: getattr(vlp16.SENSOR, name) for name in VelodyneSensor.__dataclass_fields__}
    assert TOOL["kind_of"](vlp16.SENSOR) == "Velodyne"
    with pytest.raises(TypeError, match="nothing for Wobbling"):
        TOOL["kind_of"](Wobbling(**parts))
