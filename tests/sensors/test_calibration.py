"""What a user would lose here: points in their true places, because a calibration file was read wrongly."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarcodec.errors import CalibrationError
from lidarcodec.sensor_model import CALIBRATION_FIELDS, Calibration, SensorModel
from lidarcodec.sensors import db_xml, generic_sensor, read_calibration, ros_yaml, write_calibration
from tests.sweeps import examples

FILES = [
    "hdl64e_s3_atwall_db.xml",
    "kitti_hdl64e_s2_recovered_db.xml",
    "kitti_hdl64e_s2_recovered.yaml",
    "calib_ros_64e_utexas.yaml",
    "calib_ros_64e_s2.1-sztaki.yaml",
    "calib_ros_64e_s3-xiesc.yaml",
]
XML = db_xml.text(generic_sensor("HDL-64E S3").calibration)
YAML = ros_yaml.text(generic_sensor("HDL-64E S3").calibration)


@pytest.mark.parametrize("file", FILES)
@pytest.mark.parametrize("form", ["out_db.xml", "out.yaml"])
def test_every_file_survives_both_forms(data_file, tmp_path: Path, file: str, form: str) -> None:
    sensor = read_calibration(data_file(file))
    assert (sensor.name, sensor.origin) == ("HDL-64E", "given")
    write_calibration(sensor, tmp_path / form)
    again = read_calibration(tmp_path / form)
    assert np.array_equal(again.calibration.table, sensor.calibration.table)
    assert again.hash == sensor.hash
    text = (tmp_path / form).read_text()
    write_calibration(again, tmp_path / form)
    assert (tmp_path / form).read_text() == text


def test_both_forms_of_the_kitti_calibration_agree(data_file) -> None:
    xml, yaml = (
        read_calibration(data_file(f"kitti_hdl64e_s2_recovered{end}")).calibration for end in ("_db.xml", ".yaml")
    )
    for name in CALIBRATION_FIELDS:  # the xml file has five decimals of a degree
        assert np.abs(xml[name] - yaml[name]).max() <= (1e-7 if name.endswith("_rad") else 0.0)


def test_values_of_a_db_xml_come_out_in_radians_and_metres(data_file) -> None:
    calibration = read_calibration(data_file("hdl64e_s3_atwall_db.xml")).calibration
    assert calibration["rot_correction_rad"][0] == pytest.approx(math.radians(-5.3328056), abs=1e-8)
    assert calibration["vert_correction_rad"][2] == pytest.approx(math.radians(0.250889), abs=1e-8)
    assert calibration["dist_correction_m"][2] == pytest.approx(1.3176823)
    assert calibration["dist_correction_y_m"][63] == pytest.approx(1.12)
    assert calibration["horiz_offset_m"][0] == pytest.approx(0.026)
    assert set(calibration["max_intensity"]) == {255.0}


def test_values_of_a_ros_file_come_out_as_they_are(data_file) -> None:
    calibration = read_calibration(data_file("calib_ros_64e_s2.1-sztaki.yaml")).calibration
    assert calibration["dist_correction_x_m"][0] == pytest.approx(1.5500304)
    assert calibration["focal_distance_m"][0] == pytest.approx(12.0)
    assert calibration["focal_slope"][0] == pytest.approx(1.4)
    assert (calibration["min_intensity"][0], calibration["max_intensity"][0]) == (30, 235)
    assert calibration["max_intensity"][1] == 255


def test_a_two_point_correction_of_zero_is_none(data_file) -> None:
    """The 64e_utexas file says that it has one and holds zeros: near points would come out up to 0.4 m short."""
    calibration = read_calibration(data_file("calib_ros_64e_utexas.yaml")).calibration
    assert np.array_equal(calibration["dist_correction_x_m"], calibration["dist_correction_m"])
    off = YAML.replace("two_pt_correction_available: true", "two_pt_correction_available: false")
    calibration = ros_yaml.parse(off.encode())
    assert np.array_equal(calibration["dist_correction_y_m"], calibration["dist_correction_m"])


@pytest.mark.parametrize(
    ("file", "whose"),
    [
        ("vlp16_db.xml", "16 lasers are enabled"),
        ("calib_ros_VLP16db.yaml", "VLP-16"),
        ("calib_ros_32db.yaml", "HDL-32E"),
    ],
)
def test_calibrations_of_other_sensors_are_refused(data_file, file: str, whose: str) -> None:
    with pytest.raises(CalibrationError, match=whose) as caught:
        read_calibration(data_file(file))
    assert file in str(caught.value)


@settings(max_examples=examples(40), deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_any_table_survives_both_forms(seed: int) -> None:
    rng = np.random.default_rng(seed)
    table = rng.integers(-100_000_000, 100_000_000, (len(CALIBRATION_FIELDS), 64), dtype=np.int32)
    table[-2:] = rng.integers(0, 256, (2, 64))
    table[[3, 4]] += (table[[3, 4]] == 0).astype(np.int32)
    calibration = Calibration(table)
    for form in (db_xml, ros_yaml):
        assert np.array_equal(form.parse(form.text(calibration).encode()).table, calibration.table)


def test_a_model_may_have_any_number_of_lasers() -> None:
    tables = {n: Calibration.from_values({"vert_correction_rad": np.linspace(0.2, -0.2, n)}) for n in (16, 24, 64)}
    for form in (db_xml, ros_yaml):
        files = {number: form.text(table).encode() for number, table in tables.items()}
        assert np.array_equal(form.parse(files[24], 24).table, tables[24].table)
        with pytest.raises(CalibrationError, match=r"it has 24 lasers, as another sensor has, but a VLP-16 .* has 16"):
            form.parse(files[24], 16)
        with pytest.raises(CalibrationError, match=r"it has 16 lasers, as a VLP-16 .* has, but this model has 24"):
            form.parse(files[16], 24)
    enabled = re.compile(r"(?<=<enabled_>).*?(?=</enabled_>)", re.DOTALL)
    places = enabled.sub("<item>1</item>" * 24 + "<item>0</item>" * 40, db_xml.text(tables[64]))
    found = db_xml.parse(places.encode(), 24)
    assert np.array_equal(found.table, tables[64].table[:, :24])


def test_a_field_that_is_none_is_refused_with_all_that_are() -> None:
    with pytest.raises(CalibrationError, match=r"unknown calibration fields: height; there are .* vert_offset_m, "):
        Calibration.from_values({"height": np.zeros(16)})


def test_missing_values_are_zero_and_missing_intensities_the_whole_range() -> None:
    lasers = "\n".join(f"- {{laser_id: {k}, rot_correction: 0.1, vert_correction: {-k / 100}}}" for k in range(64))
    calibration = ros_yaml.parse(f"lasers:\n{lasers}\n".encode())
    assert set(calibration["max_intensity"]) == {255.0}
    assert not calibration["dist_correction_m"].any()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("laser_id: 5,", "laser_id: 6,"), "laser 6 occurs twice"),
        (("laser_id: 5,", "laser_id: 64,"), "laser 64 does not exist: an HDL-64E has 0 to 63"),
        (("laser_id: 5,", "laser_id: five,"), "has no number"),
        (("laser_id: 5,", ""), "has no number"),
        (("rot_correction: ", "rot_correction: .nan, was: "), "number .nan is out of range"),
        (
            ("rot_correction: ", "rot_correction: 171.2, was: "),
            "rot_correction_rad must be a number in a possible range, not 171.2",
        ),
        (("vert_correction: ", "vert_corrections: "), "laser 0 has no vert_correction"),
        (
            ("dist_correction: ", "dist_correction: [], was: "),
            r"dist_correction_m must be a number in a possible range, not \[\]",
        ),
        (("dist_correction: ", "dist_correction: 1e300, was: "), "out of range"),
        (("distance_resolution: 0.002", "distance_resolution: 0.004"), "step is 0.004 m"),
        (("distance_resolution: 0.002", "distance_resolution: x"), "distance_resolution must be a number, not 'x'"),
        (("lasers:", "beams:"), "lacks the list 'lasers'"),
        (("lasers:", "lasers: 7\nrest:"), "lacks the list 'lasers'"),
        (("lasers:", "lasers: &a"), "anchors"),
        (("lasers:", "lasers: ]"), "not YAML"),
        (("lasers:", "x: !!python/object/apply:os.getcwd []\nlasers:"), "tags"),
        (("lasers:", "x: !!int ''\nlasers:"), "tags"),
        (("lasers:", "x: 2011-13-13\nlasers:"), "not YAML"),
        (("lasers:", f"x: {'[' * 50}1{']' * 50}\nlasers:"), "nested more than"),
        (("lasers:", f"x: {'1' * 5000}\nlasers:"), "characters"),
    ],
)
def test_broken_ros_files_are_refused_with_the_reason(change: tuple[str, str], message: str) -> None:
    with pytest.raises(CalibrationError, match=message):
        ros_yaml.parse(YAML.replace(*change, 1).encode())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("<id_>5<", "<id_>6<"), "laser 6 occurs twice"),
        (("<id_>5<", "<id_>5.5<"), "has no number"),
        (("<id_>5<", "<id_><"), "id_ must be a number, not ''"),
        (("<rotCorrection_>", "<rotCorrection_>nan<"), "not valid XML"),
        (("<vertCorrection_>", "<was_>1</was_><vertCorrection_>x"), "vertCorrection_ must be a number"),
        (("rotCorrection_", "rotation_"), "not valid XML"),
        (("<item>1<", "<item>inf<"), "enabled_ must be a number, not 'inf'"),
        (("<distLSB_>0.2<", "<distLSB_>0.4<"), "step is 0.004 m"),
        (("points_", "dots_"), "not valid XML"),
        (("<DB ", "<DX "), "not valid XML"),
        (("<!DOCTYPE boost_serialization>", '<!DOCTYPE b [<!ENTITY a "ha">]>'), "entities"),
        (("<!DOCTYPE boost_serialization>", "<" + "a><" * 100), "levels|not XML"),
        (("</DB>", "<x/>" * 30_000 + "</DB>"), "20000 elements"),
        (('encoding="UTF-8"', 'encoding="none-such"'), "not valid XML"),
    ],
)
def test_broken_db_xml_files_are_refused_with_the_reason(change: tuple[str, str], message: str) -> None:
    with pytest.raises(CalibrationError, match=message):
        db_xml.parse(XML.replace(*change, 1).encode())


def test_entities_cannot_hide_in_another_encoding() -> None:
    bomb = '<?xml version="1.0" encoding="UTF-16"?><!DOCTYPE b [<!ENTITY a "haha">]><b>&a;</b>'
    with pytest.raises(CalibrationError, match="entities"):
        db_xml.parse(bomb.encode("utf-16"))


def test_files_that_are_no_calibration(tmp_path: Path) -> None:
    big = tmp_path / "big.yaml"
    big.write_bytes(b" " * ((1 << 20) + 1))
    with pytest.raises(CalibrationError, match="larger than"):
        read_calibration(big)
    with pytest.raises(CalibrationError, match=r"cannot read calibration .*: No such file"):
        read_calibration(tmp_path / "none.yaml")
    with pytest.raises(CalibrationError, match="cannot read"):
        read_calibration(tmp_path)
    with pytest.raises(CalibrationError, match="cannot write calibration"):
        write_calibration(generic_sensor(), tmp_path / "none" / "x.yaml")
    for data in (b"", b"\xff\xfe\x00", b"<", b"<a/>", b"\x00" * 100, b"- 1\n- 2\n", b"lasers: []"):
        (tmp_path / "odd").write_bytes(data)
        with pytest.raises(CalibrationError, match="calibration"):
            read_calibration(tmp_path / "odd")


@settings(max_examples=examples(150), deadline=None)
@given(st.data())
def test_mutated_files_give_a_calibration_or_our_error(data: st.DataObject) -> None:
    form, source = data.draw(st.sampled_from([(db_xml, XML), (ros_yaml, YAML)]))
    text = bytearray(source.encode())
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(text) - 1))
        text[at : at + data.draw(st.integers(0, 3))] = data.draw(st.binary(max_size=3))
    try:
        calibration = form.parse(bytes(text))
    except CalibrationError:
        return
    assert SensorModel("HDL-64E", calibration).hash
