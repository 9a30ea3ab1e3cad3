"""What a user would lose here: packets of a real Velodyne or Hesai, and the name of its sensor."""

from __future__ import annotations

import numpy as np
import pytest

from lidarcodec.sensors.models.table import block_sensors, detect
from tests.sensors.captures import CAPTURES, data_packets, model_of, payloads

SENSORS = {sensor.name: sensor for sensor in block_sensors()}
EVIDENCE = {
    "vlp16": "1206 bytes, factory bytes 39 22: VLP-16, dual return",
    "vlp16 single": "1206 bytes, factory bytes 37 22: VLP-16, strongest return",
    "hdl32e": "1206 bytes, factory bytes 37 21: HDL-32E, strongest return",
    "vlp32c": "1206 bytes, factory bytes 37 28: VLP-32C, strongest return",
    "vls128": "1206 bytes, factory bytes 37 a1: VLS-128, strongest return",
    "pandar40p": "1262 bytes that begin with ff ee, 10 blocks of 40 channels, return mode 39: Pandar40P, dual return",
    "pandar64": "1198 bytes that begin with ee ff, 6 blocks of 64 channels, return mode 39: Pandar64, dual return",
    "qt128": "1127 bytes that begin with ee ff, 2 blocks of 128 channels, return mode 39: QT128, dual return",
    "xt16": "568 bytes that begin with ee ff, 8 blocks of 16 channels, return mode 39: XT16, dual return",
    "xt32m": "820 bytes that begin with ee ff, 6 blocks of 32 channels, return mode 3c: XT32M, dual return",
}


@pytest.mark.parametrize("capture", [capture for capture in CAPTURES if model_of(capture) in SENSORS])
def test_every_packet_comes_back(data_file, capture: str) -> None:
    sensor, packets = SENSORS[model_of(capture)], data_packets(data_file(CAPTURES[capture]))
    layout = sensor.layout_of(packets[0].tobytes())
    assert layout is not None
    assert layout.fits(packets).all()
    images = layout.split(packets)
    assert np.array_equal(layout.join(images), packets)
    shape = (layout.rows, len(packets) * layout.columns)
    assert {name: plane.shape for name, plane in images.planes.items()} == {one.name: shape for one in layout.planes}
    assert ("range2" in images.planes) == (layout.returns == 2)
    assert not images.series.get("azimuth_rest", np.zeros(1)).any()


@pytest.mark.parametrize("capture", CAPTURES)
def test_a_capture_is_taken_for_its_own_model_only(data_file, capture: str) -> None:
    packets = payloads(data_file(CAPTURES[capture]))
    own = SENSORS.get(model_of(capture))
    found = detect(packets)
    assert (None if found is None else SENSORS.get(found.model)) is own
    for sensor in SENSORS.values():
        if sensor is not own:
            assert not any(sensor.layout_of(payload) for payload in packets)
            assert sensor.evidence(packets[0]) is None


@pytest.mark.parametrize("capture", EVIDENCE)
def test_the_evidence_is_a_sentence_for_people(data_file, capture: str) -> None:
    packets = payloads(data_file(CAPTURES[capture]))
    assert SENSORS[model_of(capture)].evidence(packets[0]) == EVIDENCE[capture]
