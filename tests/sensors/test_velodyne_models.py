"""What a user of a Velodyne would lose here: packets, points in their true places, and the name of the sensor."""

from __future__ import annotations

import numpy as np
import pytest
import yaml

from lidarcodec.errors import CalibrationError
from lidarcodec.sensor_model import SensorModel
from lidarcodec.sensors import db_xml, ros_yaml
from lidarcodec.sensors.models import vlp16
from lidarcodec.sensors.models.table import block_sensors, detect
from lidarcodec.sensors.models.velodyne_packet import VelodyneSensor
from tests.sensors.captures import CAPTURES, data_packets, model_of

vd = pytest.importorskip("velodyne_decoder")

HOUR_S = 1_699_999_200
"""A full hour of the Unix epoch, in which all packets are said to have come."""
SENSOR = {sensor.name: sensor for sensor in block_sensors() if isinstance(sensor, VelodyneSensor)}
VELODYNE = [capture for capture in CAPTURES if model_of(capture) in SENSOR]
FILES = {
    "vlp16": ["VLP16.yaml", "../../calib_ros_VLP16db.yaml", "../../vlp16_db.xml"],
    "puck_hires": ["VLP16_hires.yaml"],
    "hdl32e": ["HDL32.yaml"],
    "vlp32c": ["VLP32.yaml", "VLP32MR.yaml"],
    "vls128": ["VLS128.yaml"],
}


@pytest.mark.parametrize("capture", VELODYNE)
def test_returns_and_points_are_those_of_velodyne_decoder(data_file, capture: str) -> None:
    _compare(SENSOR[model_of(capture)], data_packets(data_file(CAPTURES[capture])))


@pytest.mark.parametrize("capture", ["hdl32e", "vlp32c", "vls128"])
def test_made_dual_packets_are_read_as_velodyne_decoder_reads_them(data_file, capture: str) -> None:
    """No capture in this mode is at hand: packets of single returns are made into such."""
    sensor, packets = SENSOR[capture], data_packets(data_file(CAPTURES[capture]))[:200]
    made = _made_dual(packets, 4 if capture == "vls128" else 6)
    layout = sensor.layout_of(made[0].tobytes())
    assert layout is sensor.named_layout("dual")
    assert np.array_equal(layout.join(layout.split(made)), made)
    _compare(sensor, made)


@pytest.mark.parametrize("capture", ["vlp16 single", "vls128"])
def test_packets_of_the_last_return_are_taken_like_those_of_the_strongest(data_file, capture: str) -> None:
    sensor = SENSOR[model_of(capture)]
    packets = data_packets(data_file(CAPTURES[capture]))[:20].copy()
    packets[:, 1204] = 0x38
    layout = sensor.layout_of(packets[0].tobytes())
    assert layout is sensor.named_layout("single")
    assert sensor.evidence(packets[0].tobytes()).endswith("last return")
    assert np.array_equal(layout.join(layout.split(packets)), packets)


@pytest.mark.parametrize("capture", VELODYNE)
def test_azimuths_are_those_of_the_blocks(data_file, capture: str) -> None:
    sensor, packets = SENSOR[model_of(capture)], data_packets(data_file(CAPTURES[capture]))
    layout = sensor.layout_of(packets[0].tobytes())
    images = layout.split(packets)
    azimuth = sensor.azimuth(layout, images)
    assert azimuth.dtype == np.uint16
    assert azimuth.max() < 36000
    blocks = images.series["azimuth"]
    assert np.array_equal(azimuth[:: len(azimuth) // len(blocks)], blocks)
    forward = (np.diff(azimuth.astype(int)) + 18000) % 36000 - 18000
    assert forward.min() >= 0


@pytest.mark.parametrize(
    ("name", "model"),
    [
        ("vlp16", "VLP16"),
        ("puck_hires", "PuckHiRes"),
        ("hdl32e", "HDL32E"),
        ("vlp32c", "VLP32C"),
        ("vls128", "VLS128"),
    ],
)
def test_the_generic_tables_are_those_of_velodyne_decoder(name: str, model: str) -> None:
    text = vd.Calibration.default_calibs[getattr(vd.Model, model)].to_string()
    lasers = sorted(yaml.safe_load(text)["lasers"], key=lambda laser: laser["laser_id"])
    calibration = SENSOR[name].generic_sensor.calibration
    for field, key in (
        ("vert_correction_rad", "vert_correction"),
        ("rot_correction_rad", "rot_correction"),
        ("vert_offset_m", "vert_offset_correction"),
    ):
        assert np.abs(calibration[field] - [laser[key] for laser in lasers]).max() < 1e-7, field


@pytest.mark.parametrize(("name", "file"), [(name, file) for name, files in FILES.items() for file in files])
def test_published_files_hold_the_generic_angles(data_file, name: str, file: str) -> None:
    sensor = SENSOR[name]
    calibration = sensor.calibration_of(data_file(f"sensors/calibration/{file}").read_bytes())
    for field in ("vert_correction_rad", "rot_correction_rad"):
        generic = sensor.generic_sensor.calibration[field]
        assert np.abs(calibration[field] - generic).max() < 1e-4, field


@pytest.mark.parametrize("name", SENSOR)
def test_both_forms_of_a_file_give_the_calibration_back(name: str) -> None:
    sensor = SENSOR[name]
    table = sensor.generic_sensor.calibration
    for form in (db_xml.text(table, sensor.range_step_m), ros_yaml.text(table, sensor.range_step_m)):
        assert np.array_equal(sensor.calibration_of(form.encode()).table, table.table)


def test_files_of_other_sensors_are_refused(data_file) -> None:
    folder = "sensors/calibration"
    for name, file, message in (
        ("vlp16", f"{folder}/HDL32.yaml", "it has 32 lasers, as an HDL-32E or VLP-32 has, but a VLP-16 .* has 16"),
        ("vls128", f"{folder}/VLP16.yaml", "it has 16 lasers, as a VLP-16 or Puck Hi-Res has, but a VLS-128 has 128"),
        ("hdl32e", "vlp16_db.xml", "16 lasers are enabled, as in a VLP-16 .*, but an HDL-32E or VLP-32 has 32"),
        ("vlp32c", "hdl64e_s3_atwall_db.xml", "it has 64 lasers, as an HDL-64E has, but an HDL-32E or VLP-32 has 32"),
    ):
        with pytest.raises(CalibrationError, match=message):
            SENSOR[name].calibration_of(data_file(file).read_bytes())


def test_a_dual_packet_of_a_vls128_is_one_column_and_keeps_its_padding() -> None:
    rng = np.random.default_rng(1)
    sensor = SENSOR["vls128"]
    layout = sensor.named_layout("dual")
    assert layout is not None
    packets = rng.integers(0, 256, (5, 1206), np.uint8)
    for block, flag in enumerate((0xEEFF, 0xDDFF, 0xCCFF, 0xBBFF)):
        for half in range(2):
            packets[:, 100 * (2 * block + half) :][:, :2] = np.frombuffer(flag.to_bytes(2, "little"), np.uint8)
    packets[:, 1204:] = 0x39, 0xA1
    assert sensor.layout_of(packets[0].tobytes()) is layout
    images = layout.split(packets)
    assert images.planes["range2"].shape == (128, 5)
    assert np.array_equal(layout.join(images), packets)
    first = images.planes["range"][list(layout.channel_of_row).index(33)]
    assert np.array_equal(first, packets[:, 207:209].copy().view("<u2")[:, 0])
    assert sensor.times_ns(layout, images).shape == (128, 5)
    assert sensor.points(sensor.generic_sensor, layout, images, "range2")[2].shape == (128, 5)


def test_the_hires_puck_has_its_own_angles() -> None:
    payload = bytearray(b"\xff\xee" + bytes(98)) * 12 + bytes(4) + b"\x37\x24"
    found = detect([bytes(payload)])
    assert found is not None
    assert found.model == "puck_hires"
    assert vlp16.HIRES.generic_sensor.calibration["vert_correction_rad"].max() == pytest.approx(np.radians(10))


def test_corrections_of_a_file_move_the_points() -> None:
    sensor = SENSOR["vlp16"]
    layout = sensor.layouts[0]
    packet = np.frombuffer(bytes(b"\xff\xee" + bytes(2) + b"\xe8\x03\x01" * 32) * 12 + bytes(4) + b"\x37\x22", np.uint8)
    images = layout.split(packet[None])
    moved = type(sensor.generic_sensor.calibration).from_values(
        {
            "vert_correction_rad": sensor.generic_sensor.calibration["vert_correction_rad"],
            "dist_correction_m": np.full(16, 0.5),
            "horiz_offset_m": np.full(16, 0.1),
        }
    )
    x, y, z = sensor.points(SensorModel("vlp16", moved), layout, images)
    elevation = np.radians(15)
    assert x[0, 0] == pytest.approx(2.5 * np.cos(elevation))
    assert y[0, 0] == pytest.approx(0.1)
    assert z[0, 0] == pytest.approx(2.5 * np.sin(elevation))


def _compare(sensor, packets: np.ndarray) -> None:
    """Returns, points, rings and times are those of velodyne-decoder.

    The first packet of a VLS-128 is left out: the decoder does not know the speed there, and takes 0.
    """
    layout = sensor.layout_of(packets[0].tobytes())
    images = layout.split(packets)
    expected = _decoded(packets)
    names = [plane.name for plane in layout.planes if plane.role != "attribute"]
    row, column, which = _in_order_sent(sensor, [images.planes[name] for name in names])

    def of(values: list[np.ndarray]) -> np.ndarray:
        return np.stack(values)[which, row, column]

    assert len(row) == len(expected)
    assert np.array_equal(layout.rows - 1 - row, expected[:, 6])
    assert np.array_equal(of([images.planes[name.replace("range", "intensity")] for name in names]), expected[:, 3])
    known = column >= (layout.columns if sensor.name == "vls128" else 0)
    points = [sensor.points(sensor.generic_sensor, layout, images, name) for name in names]
    for axis in range(3):
        assert np.abs(of([xyz[axis] for xyz in points]) - expected[:, axis])[known].max() < 1e-4
    stamps = np.repeat(images.series["time_us"].astype(np.int64) * 1000, layout.columns)
    times = (stamps - stamps[0] + sensor.times_ns(layout, images))[row, column]
    assert np.abs(times * 1e-9 - expected[:, 4])[known].max() < 1e-6


def _made_dual(packets: np.ndarray, each: int) -> np.ndarray:
    """Packets of dual returns, of so many blocks of the given ones; every second later return is 2 or 4 mm off."""
    blocks = packets[:, :1200].reshape(len(packets), 12, 100)
    parts = []
    for part in range(12 // each):
        twice = np.repeat(blocks[:, part * each : (part + 1) * each], 2, axis=1)
        twice[:, 1::2, 4::6] ^= 1
        whole = np.zeros_like(packets)
        whole[:, : each * 200] = twice.reshape(len(packets), each * 200)
        stamps = packets[:, 1200:1204].copy().view("<u4")[:, 0] + part * 55
        whole[:, 1200:1204] = stamps.astype("<u4")[:, None].view(np.uint8)
        whole[:, 1204], whole[:, 1205] = 0x39, packets[:, 1205]
        parts.append(whole)
    return np.stack(parts, axis=1).reshape(-1, 1206)


def _decoded(packets: np.ndarray) -> np.ndarray:
    scan = vd.PacketVector()
    for packet in packets:
        host_stamp = HOUR_S + int.from_bytes(packet[1200:1204].tobytes(), "little") * 1e-6
        scan.append(vd.VelodynePacket(host_stamp, packet.tolist()))
    config = vd.Config(min_range=0, max_range=1000, timestamp_first_packet=True)
    _, points = vd.ScanDecoder(config).decode(scan)
    return points


def _in_order_sent(sensor, ranges: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Row, column and number of the return of each point that velodyne-decoder gives, in its order.

    It gives two equal returns once.
    """
    row_of_channel = np.argsort(sensor.channel_of_row)
    by_channel = np.stack(ranges)[:, row_of_channel].transpose(2, 1, 0)
    given = by_channel > 0
    if len(ranges) == 2:
        given[:, :, 0] &= by_channel[:, :, 0] != by_channel[:, :, 1]
    column, channel, which = np.nonzero(given)
    return row_of_channel[channel], column, which
