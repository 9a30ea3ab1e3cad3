"""What a user of an Ouster would lose here: the sensor's name and geometry without any option, and clear refusals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lidarcodec.codecs.other_decoder import PlaneDecoder
from lidarcodec.codecs.table import codec_id
from lidarcodec.entropy.rest_coder import encode_rest
from lidarcodec.errors import CalibrationError, SectionError
from lidarcodec.message import Message, Section, SectionType
from lidarcodec.packet_rest import PacketRest
from lidarcodec.planes.calibrations import encode_calibration
from lidarcodec.sensor_model import SensorModel
from lidarcodec.sensors import find_sensor
from lidarcodec.sensors.models.ouster.sensor import bare_sensors, model_from
from lidarcodec.sensors.models.table import OUSTERS, detect, is_known, names, sensor_named, sensor_of
from lidarcodec.sensors.recognise import recognised, takes
from tests.sensors.captures import payloads
from tests.sensors.ouster_packets import CAPTURES, FOLDER, LAYOUTS, as_json, flat_metadata, likely_packets

RNG15 = LAYOUTS["RNG15_RFL8_NIR8 128"]
PACKETS = [packet.tobytes() for packet in likely_packets(RNG15, 4)]
BARE = "ouster-128-rng15_rfl8_nir8"


@pytest.mark.parametrize("capture", CAPTURES)
def test_a_capture_has_the_sensor_of_the_metadata_beside_it(data_file, capture: str) -> None:
    path = data_file(f"{FOLDER}/{capture}.pcap.xz")
    metadata = data_file(f"{FOLDER}/{CAPTURES[capture]}.json").read_bytes()
    found = payloads(path)
    sensor = find_sensor(path, None, found[:64])
    assert sensor.model in OUSTERS
    assert (sensor.origin, sensor.description) == ("beside", metadata)
    family = sensor_of(sensor)
    assert family is not None
    assert family.name == sensor.model
    assert takes(sensor.model, found)
    evidence = recognised(found).evidence
    assert evidence.endswith(f"{family.layout.profile}, without metadata")


@pytest.mark.parametrize("name", LAYOUTS)
def test_packets_alone_have_a_sensor(name: str) -> None:
    layout = LAYOUTS[name]
    packets = [packet.tobytes() for packet in likely_packets(layout, 8)]
    imu = [bytes(48)] * 20
    found = detect(packets + imu)
    assert found is not None
    assert found.model == f"ouster-{layout.rows}-{layout.name}"
    sensor = find_sensor(None, None, packets + imu)
    assert (sensor.model, sensor.origin, sensor.rows) == (found.model, "generic", layout.rows)
    assert sensor_of(sensor) is bare_sensors()[found.model]
    assert is_known(found.model)


def test_metadata_that_is_given_must_fit(tmp_path: Path) -> None:
    path = tmp_path / "os.json"
    path.write_bytes(as_json(flat_metadata()))
    sensor = find_sensor(None, path, PACKETS)
    assert (sensor.model, sensor.origin) == ("os1-128", "given")
    assert find_sensor(None, path, PACKETS, "os1-128").hash == sensor.hash
    assert find_sensor(None, path, [], "os1-128").hash == sensor.hash
    with pytest.raises(CalibrationError, match=r"os\.json is of an os1-128, not of an os0-128"):
        find_sensor(None, path, PACKETS, "os0-128")
    path.write_bytes(as_json(flat_metadata("LEGACY")))
    with pytest.raises(CalibrationError, match=r"is of an os1-128 that sends packets of 24896 bytes, but these have"):
        find_sensor(None, path, PACKETS)
    path.write_bytes(b"{}")
    with pytest.raises(CalibrationError, match=r"metadata .*os\.json: it lacks the list beam_altitude_angles"):
        find_sensor(None, path, PACKETS)
    with pytest.raises(CalibrationError, match=r"none\.json"):
        find_sensor(None, tmp_path / "none.json", PACKETS)
    with pytest.raises(
        CalibrationError, match=r"os1-128 needs its metadata: save http://SENSOR/api/v1/sensor/metadata"
    ):
        find_sensor(tmp_path / "drive.pcap", None, PACKETS, "os1-128")


def test_a_model_takes_packets_of_its_number_of_beams() -> None:
    assert takes("os0-128", PACKETS)
    assert not takes("os0-32", PACKETS)
    assert not takes("os0-128", [bytes(1206)])
    assert takes(BARE, PACKETS)
    assert set(OUSTERS) <= set(names())
    with pytest.raises(CalibrationError, match="needs its metadata"):
        sensor_named("os2-64")


def test_a_message_brings_the_metadata(tmp_path: Path) -> None:
    sensor = model_from(as_json(flat_metadata()), "given")
    back = _decoded(sensor)
    assert (back.hash, back.description) == (sensor.hash, sensor.description)
    images = RNG15.split(likely_packets(RNG15, 2))
    points = [sensor_of(one).points(one, RNG15, images) for one in (sensor, back)]
    assert np.array_equal(points[0], points[1])


def test_a_message_with_a_description_that_does_not_fit_is_refused() -> None:
    sensor = model_from(as_json(flat_metadata()), "given")
    for wrong in (
        replace(sensor, description=b""),
        replace(sensor, description=b"[" * 1000),
        replace(sensor, model="os0-128"),
        replace(sensor, range_step_m=0.002),
        replace(sensor, description=as_json(flat_metadata(rows=64))),
    ):
        with pytest.raises(SectionError, match="a sensor whose description cannot be used"):
            _decoded(wrong)
    with pytest.raises(SectionError, match="which this build does not know"):
        _decoded(replace(sensor, model="ouster-128-none"))


def _decoded(sensor: SensorModel) -> SensorModel:
    """The sensor that a key message of this one describes."""
    rest = PacketRest("", np.zeros(0, np.int64), np.zeros(0, np.uint16), ())
    sections = (
        Section(SectionType.CALIBRATION, encode_calibration(sensor, key=True)),
        Section(SectionType.REST, encode_rest(rest)),
    )
    codec = codec_id("raw")
    (frame,) = PlaneDecoder(codec).decode(Message(codec, 1, 0, 0, True, 0, 0, sections, planes=True))
    return frame.sensor
