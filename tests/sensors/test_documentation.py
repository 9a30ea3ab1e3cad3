"""What a user would lose here: trust in docs/sensors.md, whose examples and tables must be what the code does."""

from __future__ import annotations

import doctest

from lidarcodec.sensors import generic_sensor
from lidarcodec.sensors.generic import TABLES
from lidarcodec.sensors.table import MODELS
from tests.conftest import ROOT

PAGE = ROOT / "docs" / "sensors.md"


def test_the_examples_run() -> None:
    failed, tried = doctest.testfile(str(PAGE), module_relative=False)
    assert tried >= 4
    assert failed == 0


def test_every_model_and_every_refused_sensor_is_named() -> None:
    text = PAGE.read_text()
    for name in MODELS.values():
        assert name.replace("VLP-32A or VLP-32B", "VLP-32A/B/C").replace("VLP-32C", "VLP-32A/B/C") in text
    for model in TABLES:
        assert model.removeprefix("HDL-64E ") in text
        assert generic_sensor(model).name == model
