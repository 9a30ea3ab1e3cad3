"""What a user would lose here: trust in docs/sensors.md, whose examples and tables must be what the code does."""

from __future__ import annotations

import doctest

from lidarcodec.sensors import generic_sensor
from lidarcodec.sensors.generic import TABLES
from lidarcodec.sensors.models.table import block_sensors
from lidarcodec.sensors.recognise import UNKNOWN
from tests.conftest import ROOT

PAGE = ROOT / "docs" / "sensors.md"


def test_the_examples_run() -> None:
    failed, tried = doctest.testfile(str(PAGE), module_relative=False)
    assert tried >= 4
    assert failed == 0


def test_every_model_and_every_refused_sensor_is_named() -> None:
    text = PAGE.read_text()
    for sensor in block_sensors():
        step = f"{round(sensor.range_step_m * 1000)} mm"
        rows = [line for line in text.splitlines() if line.startswith("| ") and f"| `{sensor.name}` |" in line]
        assert rows, f"docs/sensors.md has no row with | `{sensor.name}` |"
        row = rows[0]
        assert f"| {sensor.title.partition(' (')[0]}" in row
        assert f"| {step} |" in row
        for size in sensor.packet_sizes:
            assert str(size) in row
    for name in UNKNOWN.values():
        for one in name.split(" or "):
            assert one in text
    for model in TABLES:
        assert model.removeprefix("HDL-64E ") in text
        assert generic_sensor(model).name == model
