"""`info` of a recording says which sensor it is of: files of several sensors lie beside each other."""

from __future__ import annotations

import contextlib
import json

import pytest

from lidarcodec.errors import DecodeError
from lidarcodec.planes.calibrations import encode_calibration, peek_sensor
from lidarcodec.sensors import find_sensor
from tests.command_line import run_here

SOURCES = {
    "hdl64e": ("sim:road", "HDL-64E", 64),
    "vlp16": ("sim:road?sensor=vlp16", "VLP-16", 16),
    "os1-32": ("sim:road?sensor=os1-32", "OS1-32", 32),
}


@pytest.mark.parametrize("form", ["recording", "packets"])
@pytest.mark.parametrize("model", SOURCES)
def test_info_names_the_sensor_of_a_recording(tmp_path, model, form):
    spec, name, rows = SOURCES[model]
    out = tmp_path / "drive.mcap"
    made = run_here("convert", spec, str(out), "--as", form, "--frames", "1")
    assert made.returncode == 0, made.stderr
    found = json.loads(run_here("info", str(out), "--json").stdout)
    assert (found["model"], found["rows"]) == (model, rows)
    assert name.replace("-", "") in found["sensor"].replace("-", "").replace(" ", "")


@pytest.mark.parametrize("model", SOURCES)
def test_info_says_of_each_sensor_by_what_it_was_recognised(tmp_path, model):
    """Of an HDL-64E it did not."""
    out = tmp_path / "drive.pcap"
    assert run_here("convert", SOURCES[model][0], str(out), "--frames", "1").returncode == 0
    found = json.loads(run_here("info", str(out), "--json").stdout)
    assert (found["rows"], found["range_step_m"] > 0) == (SOURCES[model][2], True)
    assert found["evidence"] not in ("", "named by --model")


@pytest.mark.parametrize("model", ["hdl64e", "vlp16"])
def test_a_section_that_was_cut_or_changed_is_refused_or_named_but_never_ends_info(model):
    section = encode_calibration(find_sensor(None, None, [], model), key=True)
    assert peek_sensor(section).model == model
    for length in range(0, len(section), 1 + len(section) // 200):
        changed = section[:length] + bytes([section[length] ^ 0x41]) + section[length + 1 :]
        for hostile in (section[:length], changed):
            with contextlib.suppress(DecodeError):
                peek_sensor(hostile)
