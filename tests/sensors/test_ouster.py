"""What a user of an Ouster would lose here: packets, points in their true places, times, and the name of the sensor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from lidarcodec.errors import CalibrationError
from lidarcodec.sensors.images import Images
from lidarcodec.sensors.models.ouster.fields import LEGACY, PIXELS
from lidarcodec.sensors.models.ouster.sensor import (
    OusterSensor,
    bare_sensor_of,
    destaggered,
    model_from,
    sensor_from,
)
from tests.sensors.captures import payloads
from tests.sensors.ouster_packets import CAPTURES, FOLDER, LAYOUTS, as_json, flat_metadata, random_packets

core = pytest.importorskip("ouster.sdk.core", reason="needs ouster-sdk: docs/development.md says how to install it")

NAMES = {
    "OS-0-32-U1_v2.2.0_1024x10": "os0-32",
    "OS-1-128_767798045_1024x10_20230712_120049": "os1-128",
    "OS-1-128_v2.3.0_1024x10_lb_n3": "os1-128",
    "OS-1-32-G_v2.1.1_1024x10": "os1-32",
    "OS-1-64_1024x10_fw20": "os1-64",
    "OS-2-128-U1_v2.3.0_1024x10": "os2-128",
    "shot_limiting_test": "os0-128",
    "windowed_frame1": "os0-128",
}
FIELDS = {
    "range": "RANGE",
    "range2": "RANGE2",
    "intensity": "REFLECTIVITY",
    "intensity2": "REFLECTIVITY2",
    "signal": "SIGNAL",
    "signal2": "SIGNAL2",
    "near_ir": "NEAR_IR",
    "flags": "FLAGS",
    "flags2": "FLAGS2",
    "window": "WINDOW",
}
HEAD = ("packet_type", "frame_id", "init_id", "prod_sn", "alert_flags", "crc")


@dataclass
class Capture:
    """A capture, taken apart, and what ouster-sdk knows of its sensor."""

    sensor: OusterSensor
    metadata: bytes
    all_payloads: list[bytes]
    packets: np.ndarray
    images: Images
    info: object


@pytest.fixture(scope="module", params=CAPTURES)
def capture(request, data_file) -> Capture:
    path = data_file(f"{FOLDER}/{request.param}.pcap.xz")
    metadata = data_file(f"{FOLDER}/{CAPTURES[request.param]}.json").read_bytes()
    sensor = sensor_from(metadata)
    assert sensor.name == NAMES[request.param]
    found = payloads(path)
    right = [payload for payload in found if sensor.layout_of(payload) is not None]
    packets = np.frombuffer(b"".join(right), np.uint8).reshape(len(right), -1)
    info = core.SensorInfo(metadata.decode())
    return Capture(sensor, metadata, found, packets, sensor.layout.split(packets), info)


def test_every_packet_with_ranges_comes_back(capture: Capture) -> None:
    layout = capture.sensor.layout
    lidar = [payload for payload in capture.all_payloads if len(payload) != 48]
    assert len(capture.packets) == len(lidar) > 0
    assert layout.fits(capture.packets).all()
    assert np.array_equal(layout.join(capture.images), capture.packets)
    for plane in layout.planes:
        assert capture.images.planes[plane.name].shape == (layout.rows, len(lidar) * layout.columns)
        assert capture.images.planes[plane.name].dtype == plane.dtype


def test_planes_and_numbers_are_the_fields_of_ouster_sdk(capture: Capture) -> None:
    _compare_with_sdk(capture.sensor, capture.info, capture.packets)


def test_points_are_those_of_ouster_sdk(capture: Capture) -> None:
    sensor, images = capture.sensor, capture.images
    ids = images.series["measurement_id"]
    lut = core.XYZLut(capture.info)
    for plane in ("range", "range2"):
        if plane not in images.planes:
            continue
        points = sensor.points(model_from(capture.metadata, "given"), sensor.layout, images, plane)
        worst = 0.0
        for first in range(0, len(ids), 1024):  # one turn at a time, for ids come again
            part = slice(first, first + 1024)
            millimetres = images.planes[plane][:, part].astype(np.uint32) * round(sensor.range_step_m * 1000)
            turn = np.zeros((sensor.layout.rows, capture.info.format.columns_per_frame), np.uint32)
            turn[:, ids[part]] = millimetres
            expected = lut(turn)[:, ids[part]]
            ours = np.stack(points, axis=-1)[:, part]
            worst = max(worst, np.abs(ours - expected)[millimetres > 0].max(initial=0))
        assert worst < 1e-4


def test_columns_are_where_their_points_are(capture: Capture) -> None:
    """The azimuth of a far point is that of its column and the beam's own; near ones are seen from off the axis."""
    sensor, images = capture.sensor, capture.images
    x, y, _ = sensor.points(model_from(capture.metadata, "given"), sensor.layout, images)
    beam = sensor.metadata.beam_azimuth_deg[:, None]
    off = np.degrees(np.arctan2(-y, x)) - sensor.azimuth(sensor.layout, images) / 100 - beam
    far = images.planes["range"] * sensor.range_step_m > 15
    assert np.abs((off + 180) % 360 - 180)[far].max(initial=0) < 0.1


def test_rows_go_from_the_top_down(capture: Capture) -> None:
    assert (np.diff(capture.sensor.metadata.beam_altitude_deg) < 0).all()
    model = model_from(capture.metadata, "beside")
    assert np.array_equal(model.laser_of_ring, np.arange(capture.sensor.layout.rows))
    assert (model.model, model.origin, model.description) == (capture.sensor.name, "beside", capture.metadata)
    assert model.range_step_m == capture.sensor.range_step_m
    degrees = np.degrees(model.calibration["vert_correction_rad"])
    assert np.abs(degrees - capture.info.beam_altitude_angles).max() < 1e-6


def test_times_begin_with_each_packet(capture: Capture) -> None:
    layout = capture.sensor.layout
    times = capture.sensor.times_ns(layout, capture.images)
    assert times.shape == (1, len(capture.packets) * layout.columns)
    stamps = capture.images.series["time_ns"].reshape(-1, layout.columns).astype(np.int64)
    assert np.array_equal(times.reshape(stamps.shape) + stamps[:, :1], stamps)
    turn_ns = 1_000_000_000 / capture.sensor.metadata.turns_per_second
    assert np.abs(np.diff(stamps) * capture.sensor.metadata.columns_per_frame / turn_ns - 1).max() < 0.2


def test_metadata_is_what_ouster_sdk_reads(capture: Capture) -> None:
    ours, theirs = capture.sensor.metadata, capture.info
    assert ours.column_window == tuple(theirs.format.column_window)
    assert ours.lidar_mode == str(theirs.config.lidar_mode)
    assert ours.layout.columns == theirs.format.columns_per_packet
    assert np.array_equal(ours.pixel_shift_by_row, theirs.format.pixel_shift_by_row)
    assert ours.lidar_origin_to_beam_origin_mm == theirs.lidar_origin_to_beam_origin_mm
    assert np.array_equal(ours.beam_to_lidar, theirs.beam_to_lidar_transform)
    assert np.array_equal(ours.lidar_to_sensor, theirs.lidar_to_sensor_transform)


def test_columns_outside_of_the_window_are_empty(data_file) -> None:
    sensor = sensor_from(data_file(f"{FOLDER}/windowed_frame1_0.json").read_bytes())
    found = payloads(data_file(f"{FOLDER}/windowed_frame1.pcap.xz"))
    right = [payload for payload in found if sensor.layout_of(payload)]
    images = sensor.layout.split(np.frombuffer(b"".join(right), np.uint8).reshape(len(right), -1))
    first, last = sensor.metadata.column_window
    ids = images.series["measurement_id"]
    inside = (ids >= first) & (ids <= last)
    assert np.array_equal(images.series["status"] == 1, inside)
    assert inside.sum() == 256
    assert not images.planes["range"][:, ~inside].any()


def test_destaggered_images_are_those_of_ouster_sdk(capture: Capture) -> None:
    columns = capture.info.format.columns_per_frame
    image = capture.images.planes["range"][:, :columns]
    if image.shape[1] < columns:
        image = np.random.default_rng(1).integers(0, 1000, (capture.sensor.layout.rows, columns), np.uint32)
    shifts = capture.sensor.metadata.pixel_shift_by_row
    assert np.array_equal(destaggered(image, shifts), core.destagger(capture.info, image))


def test_packets_alone_show_their_layout(capture: Capture) -> None:
    sensors = [bare_sensor_of(payload) for payload in capture.all_payloads]
    layout = capture.sensor.layout
    for sensor, payload in zip(sensors, capture.all_payloads, strict=True):
        if len(payload) == 48:
            assert sensor is None
            continue
        assert sensor is not None
        assert (sensor.layout.profile, sensor.layout.rows) == (layout.profile, layout.rows)
        assert sensor.layout_of(payload) is sensor.layout
    bare = next(sensor for sensor in sensors if sensor is not None)
    assert bare.range_step_m == capture.sensor.range_step_m
    columns = capture.sensor.metadata.columns_per_frame
    if capture.images.series["measurement_id"].max() >= columns // 2:  # else the mode cannot be seen
        azimuth = capture.sensor.azimuth(layout, capture.images)
        assert np.array_equal(bare.azimuth(bare.layout, capture.images), azimuth)
    with pytest.raises(CalibrationError, match=r"save http://SENSOR/api/v1/sensor/metadata as NAME\.json beside"):
        bare.points(bare.generic_sensor, bare.layout, capture.images)
    assert bare.calibrated(capture.metadata, "given", "os.json").model == capture.sensor.name


@pytest.mark.parametrize("name", LAYOUTS)
def test_every_layout_has_the_fields_of_ouster_sdk(name: str) -> None:
    layout = LAYOUTS[name]
    metadata = as_json(flat_metadata(layout.profile, layout.rows))
    info = core.SensorInfo(metadata.decode())
    assert core.PacketFormat.from_info(info).lidar_packet_size == layout.packet_bytes
    packets = random_packets(layout, 3)
    assert layout.fits(packets).all()
    _compare_with_sdk(sensor_from(metadata), info, packets)


@pytest.mark.parametrize(("profile", "head", "columns"), [("RNG15_RFL8_NIR8", "FUSA", 16), ("LEGACY", "STANDARD", 8)])
def test_other_heads_and_columns_are_those_of_ouster_sdk(profile: str, head: str, columns: int) -> None:
    tree = flat_metadata(profile, 32)
    tree["data_format"] |= {"header_type": head, "columns_per_packet": columns}
    sensor, info = sensor_from(as_json(tree)), core.SensorInfo(as_json(tree).decode())
    assert core.PacketFormat.from_info(info).lidar_packet_size == sensor.layout.packet_bytes
    _compare_with_sdk(sensor, info, random_packets(sensor.layout, 3))


def _compare_with_sdk(sensor: OusterSensor, info: object, packets: np.ndarray) -> None:
    reader, layout = core.PacketFormat.from_info(info), sensor.layout
    images = layout.split(packets)
    known = {field.name: field for field in PIXELS[layout.profile]}
    for plane in layout.planes:
        ours = images.planes[plane.name]
        theirs = np.concatenate([reader.packet_field(FIELDS[plane.name], packet) for packet in packets], axis=1)
        if plane.name == "flags" and layout.profile == LEGACY:
            ours = ours >> 8
        elif plane.name == "flags" and known["flags"].bits > 5:
            ours = ours & 31
        elif plane.name == "intensity":
            ours = ours & 255
        elif "RNG15" in layout.profile and plane.name in ("range", "range2", "near_ir"):
            ours = ours.astype(np.uint32) << (4 if plane.name == "near_ir" else 3)
        assert np.array_equal(ours, theirs), plane.name
    headers = {
        "time_ns": core.ColHeader.TIMESTAMP,
        "measurement_id": core.ColHeader.MEASUREMENT_ID,
        "status": core.ColHeader.STATUS,
    }
    if layout.legacy:
        headers["encoder"] = core.ColHeader.ENCODER_COUNT
        headers["frame_id"] = core.ColHeader.FRAME_ID
    for name, header in headers.items():
        theirs = np.concatenate([reader.packet_header(header, packet) for packet in packets])
        assert np.array_equal(images.series[name], theirs), name
    for name in () if layout.legacy else HEAD:
        theirs = [getattr(reader, name)(packet) for packet in packets]
        if name == "crc" and layout.fusa_head:
            assert theirs == [None] * len(packets)  # ouster-sdk does not read it there
            continue
        assert images.series["serial" if name == "prod_sn" else name].tolist() == theirs, name
