"""What a user would lose here: an Ouster's geometry, or a clear sentence about a file that holds none."""

from __future__ import annotations

import copy
import json
import logging
import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarcodec.errors import CalibrationError
from lidarcodec.sensors.models.ouster.beside import metadata_beside
from lidarcodec.sensors.models.ouster.metadata import read_metadata
from lidarcodec.sensors.models.ouster.sensor import bare_sensors, model_from, sensor_from
from tests.sensors.captures import payloads
from tests.sensors.ouster_packets import (
    CAPTURES,
    FOLDER,
    LAYOUTS,
    as_json,
    flat_metadata,
    likely_packets,
    nested_metadata,
)
from tests.sweeps import examples

ANGLES = "beam_altitude_angles"
MORE = {
    "lidar_mode": [None, 7, "1000x10", "1024x0", "1024x", "x", "2048x10", "9" * 40, ["1024x10"]],
    "prod_line": ["VLP-16", 5, "OS-3-128", "OS-12-128"],
    "prod_sn": [5, []],
    "beam_altitude_angles": [None, [], [0.0] * 127, [1e9] * 128, ["1"] * 128, [True] * 128, {}, [[0.0]] * 128],
    "beam_azimuth_angles": [None, [0.0] * 64, [400] * 128, "0", [None] * 128],
    "lidar_origin_to_beam_origin_mm": ["15", 1e6, [15], False],
    "lidar_to_sensor_transform": [
        [],
        [0] * 16,
        [1] * 16,
        [2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 1],
        5,
        [[1]] * 4,
    ],
    "beam_to_lidar_transform": [[1, 0, 0, 1e9, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1], ["1"] * 16],
    "data_format": [[], "LEGACY", 5],
}
"""Key -> values that are refused."""
FORMATS = {
    "columns_per_frame": [512, "1024", -1],
    "columns_per_packet": [0, 65, 16.0, True, "16", 10**15],
    "column_window": [[0], [0, 1024], [-1, 5], "all", [0.5, 2], None],
    "pixel_shift_by_row": [[0] * 127, [5000] * 128, ["0"] * 128, 3],
    "pixels_per_column": [64, "128", None],
    "udp_profile_lidar": ["RNG15_RFL8_NIR8_ZONE16", 5, "", ["LEGACY"]],
    "header_type": ["NONE", 5],
}


def test_flat_and_nested_metadata_say_the_same() -> None:
    flat = flat_metadata()
    one, other = read_metadata(as_json(flat)), read_metadata(as_json(nested_metadata(flat)))
    assert (one.model, one.product, one.serial, one.layout) == (other.model, other.product, other.serial, other.layout)
    assert (one.lidar_mode, one.turns_per_second, one.columns_per_frame) == ("1024x10", 10, 1024)
    for name in ("beam_altitude_deg", "beam_azimuth_deg", "pixel_shift_by_row", "beam_to_lidar", "lidar_to_sensor"):
        assert np.array_equal(getattr(one, name), getattr(other, name))


@pytest.mark.parametrize(
    ("product", "rows", "name"),
    [
        ("OS-0-128", 128, "os0-128"),
        ("OS-1-16-A0", 16, "os1-16"),
        ("OS-2-64-U1", 64, "os2-64"),
        ("OS-1-32-G", 32, "os1-32"),
        ("OS-DOME-128", 128, "osdome-128"),
        ("OSDome-64", 64, "osdome-64"),
        ("", 64, "os1-64"),
    ],
)
def test_models_are_named_by_product_and_rows(product: str, rows: int, name: str) -> None:
    metadata = as_json(flat_metadata("LEGACY", rows, product))
    assert sensor_from(metadata).name == name
    assert model_from(metadata, "given").model == name
    assert model_from(metadata, "given").rows == rows


def test_what_old_files_lack_is_what_those_sensors_had() -> None:
    flat = flat_metadata("LEGACY", 64)
    old = {key: flat[key] for key in (ANGLES, "beam_azimuth_angles", "lidar_mode")}
    read = read_metadata(as_json(old))
    assert (read.layout.profile, read.layout.columns, read.column_window) == ("LEGACY", 16, (0, 1023))
    assert read.lidar_origin_to_beam_origin_mm == 12.163
    assert read.beam_to_lidar[0, 3] == 12.163
    assert read.lidar_to_sensor[2, 3] == 36.18
    assert read.pixel_shift_by_row[:5].tolist() == [18, 12, 6, 0, 18]
    assert read_metadata(as_json({**old, "lidar_mode": "2048x10"})).pixel_shift_by_row[0] == 36


def test_the_head_of_functional_safety_can_come_with_any_profile() -> None:
    flat = flat_metadata()
    flat["data_format"]["header_type"] = "FUSA"
    assert sensor_from(as_json(flat)).layout.name == "rng15_rfl8_nir8_head_fusa"
    assert sensor_from(as_json(flat_metadata("FUSA_RNG15_RFL8_NIR8_DUAL"))).layout.name == "fusa_rng15_rfl8_nir8_dual"


@pytest.mark.parametrize(("key", "value"), [(key, value) for key, values in MORE.items() for value in values])
def test_impossible_values_are_refused_in_one_sentence(key: str, value: object) -> None:
    flat = flat_metadata()
    flat[key] = value
    _check_refused(as_json(flat))


@pytest.mark.parametrize(("key", "value"), [(key, value) for key, values in FORMATS.items() for value in values])
def test_impossible_data_formats_are_refused_in_one_sentence(key: str, value: object) -> None:
    flat = flat_metadata()
    flat["data_format"][key] = value
    _check_refused(as_json(flat))
    _check_refused(as_json(nested_metadata(flat)))


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\xff\xfe",
        b"[]",
        b"null",
        b"{}",
        b"[" * 100_000,
        b'{"a":' * 17 + b"1" + b"}" * 17,
        as_json({ANGLES: [0.0] * 1_000_000}),
        as_json({ANGLES: [0.0] * 20_000, "beam_azimuth_angles": [0.0] * 20_000}),
        as_json(flat_metadata()).replace(b"36.18", b"NaN"),
        as_json(flat_metadata()).replace(b"36.18", b"Infinity"),
        as_json(flat_metadata()).replace(b"36.18", b"1e999"),
        as_json(flat_metadata()).replace(b"36.18", b"9" * 400),
        as_json({"beam_intrinsics": [], **flat_metadata()}),
    ],
)
def test_hostile_documents_are_refused_in_one_sentence(data: bytes) -> None:
    _check_refused(data)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=12),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=8,
)


@given(st.data())
@settings(deadline=None, max_examples=examples(200))
def test_changed_metadata_is_read_or_refused(data: st.DataObject) -> None:
    tree = flat_metadata(rows=16) if data.draw(st.booleans()) else nested_metadata(flat_metadata(rows=16))
    tree = copy.deepcopy(tree)
    for _ in range(data.draw(st.integers(1, 3))):
        place: object = tree
        while isinstance(place, (dict, list)) and place:
            key = data.draw(st.sampled_from(sorted(place) if isinstance(place, dict) else range(len(place))))
            if data.draw(st.booleans()) or not isinstance(place[key], (dict, list)):
                if isinstance(place, dict) and data.draw(st.booleans()):
                    del place[key]
                else:
                    place[key] = data.draw(JSON)
                break
            place = place[key]
    _check_read_or_refused(json.dumps(tree, allow_nan=True).encode())


@given(st.data())
@settings(deadline=None, max_examples=examples(200))
def test_changed_bytes_are_read_or_refused(data: st.DataObject) -> None:
    document = bytearray(as_json(flat_metadata(rows=16)))
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(document) - 1))
        document[at : at + data.draw(st.integers(0, 3))] = data.draw(st.binary(max_size=3))
    _check_read_or_refused(bytes(document))


@pytest.mark.parametrize("capture", CAPTURES)
def test_metadata_is_found_beside_each_capture(data_file, capture: str) -> None:
    path = data_file(f"{FOLDER}/{capture}.pcap.xz")
    found = metadata_beside(path, payloads(path))
    assert found == path.parent / f"{CAPTURES[capture]}.json"


def test_metadata_of_another_sensor_is_not_taken(tmp_path: Path, caplog) -> None:
    capture = tmp_path / "OS-1-128_drive.pcap.xz"
    packets = [packet.tobytes() for packet in likely_packets(LAYOUTS["RNG15_RFL8_NIR8 128"], 2)]
    right = flat_metadata()
    (tmp_path / "OS-1-128_other_profile.json").write_bytes(as_json(flat_metadata("LEGACY")))
    (tmp_path / "OS-1-128_other_unit.json").write_bytes(as_json({**right, "prod_sn": "122201000999"}))
    (tmp_path / "OS-1-128_broken.json").write_bytes(b"{")
    (tmp_path / "elsewhere.json").write_bytes(as_json(right))
    assert metadata_beside(capture, packets) is None
    (tmp_path / "OS-1-128.json").write_bytes(as_json(right))
    assert metadata_beside(capture, packets) == tmp_path / "OS-1-128.json"
    (tmp_path / "OS-1-128_copy.json").write_bytes(as_json(right))
    with caplog.at_level(logging.WARNING):
        assert metadata_beside(capture, packets) is None
    assert "each could be the metadata of" in caplog.text
    (tmp_path / "OS-1-128_drive_2.json").write_bytes(as_json(right))
    assert metadata_beside(capture, packets) == tmp_path / "OS-1-128_drive_2.json"
    (tmp_path / "OS-1-128_drive.json").write_bytes(as_json(nested_metadata(right)))
    assert metadata_beside(capture, packets) == tmp_path / "OS-1-128_drive.json"


def test_a_file_of_the_capture_s_name_that_does_not_fit_is_skipped_with_a_warning(tmp_path: Path, caplog) -> None:
    packets = [packet.tobytes() for packet in likely_packets(LAYOUTS["RNG15_RFL8_NIR8 128"], 2)]
    (tmp_path / "drive.json").write_bytes(as_json({"format": "something else"}))
    with caplog.at_level(logging.WARNING):
        assert metadata_beside(tmp_path / "drive.pcap", packets) is None
    assert "not the metadata of the Ouster that sent" in caplog.text
    assert metadata_beside(tmp_path / "missing" / "drive.pcap", packets) is None
    assert metadata_beside(tmp_path / ("n" * 5000), packets) is None


def test_a_folder_full_of_files_is_not_read_through(tmp_path: Path) -> None:
    packets = [packet.tobytes() for packet in likely_packets(LAYOUTS["RNG15_RFL8_NIR8 128"], 2)]
    (tmp_path / "drive_0.json").write_bytes(as_json(flat_metadata()))
    for number in range(1, 70):
        shutil.copy(tmp_path / "drive_0.json", tmp_path / f"drive_{number}.json")
    assert metadata_beside(tmp_path / "drive.pcap", packets) is None


def test_calibration_given_for_packets_must_be_of_their_layout() -> None:
    bare = bare_sensors()["ouster-128-rng15_rfl8_nir8"]
    assert bare.calibrated(as_json(flat_metadata()), "given", "os.json").model == "os1-128"
    assert bare.generic_sensor.rows == 128
    with pytest.raises(CalibrationError, match=r"metadata os.json is of Ouster OS-1-128, 1024x10, LEGACY, but the"):
        bare.calibrated(as_json(flat_metadata("LEGACY")), "given", "os.json")
    with pytest.raises(CalibrationError, match=r"metadata os.json: it lacks the list beam_altitude_angles"):
        bare.calibrated(b"{}", "given", "os.json")


def _check_refused(data: bytes) -> None:
    with pytest.raises(CalibrationError) as raised:
        model_from(data, "given")
    text = str(raised.value)
    assert "\n" not in text
    assert 10 < len(text) < 300
    assert "Traceback" not in text


def _check_read_or_refused(data: bytes) -> None:
    try:
        model = model_from(data, "given")
    except CalibrationError:
        _check_refused(data)
        return
    assert model.rows in (16, 32, 64, 128)
    sensor = sensor_from(data)
    images = sensor.layout.split(likely_packets(sensor.layout, 1))
    for axis in sensor.points(model, sensor.layout, images):
        assert np.isfinite(axis).all()
    assert sensor.azimuth(sensor.layout, images).max() < 36000
