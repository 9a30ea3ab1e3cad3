"""What a user of a Hesai would lose here: packets, points in their true places, and the name of the sensor."""

from __future__ import annotations

import numpy as np
import pytest

from lidarcodec.sensor_model import SensorModel
from lidarcodec.sensors.models.hesai_packet import HesaiSensor
from lidarcodec.sensors.models.table import block_sensors
from tests.sensors.captures import CAPTURES, data_packets, model_of, pcd_points

SENSOR = {sensor.name: sensor for sensor in block_sensors() if isinstance(sensor, HesaiSensor)}
CALIBRATIONS = {
    "pandar40p": "Pandar40P.csv",
    "pandar64": "Pandar64.csv",
    "qt64": "PandarQT64.csv",
    "qt128": "PandarQT128.csv",
    "xt16": "PandarXT16.csv",
    "xt32": "PandarXT32.csv",
    "xt32m": "PandarXT32M.csv",
}
CLOUDS = {
    "pandar40p": "pandar_40p_1673400149711850138.pcd.xz",
    "pandar64": "pandar_64_1673403880898440686.pcd.xz",
    "qt128": "pandar_qt128_1730273789174759609.pcd.xz",
    "xt16": "pandar_xt16_1732848128093928016.pcd.xz",
    "xt32m": "pandar_xt32m_1660893203292679064.pcd.xz",
}
"""What nebula decodes of a scan of the capture."""
MANUAL = {
    "pandar40p": ((1262, 1266), 10),
    "pandar64": ((1198, 1194), 6),
    "qt64": ((1072, 1068), 4),
    "qt128": ((1127, 1095), 2),
    "xt16": ((568,), 8),
    "xt32": ((1080,), 8),
    "xt32m": ((820,), 6),
}
"""Bytes of a packet in each of its forms, and columns of one return."""
NEAR_M = 1e-3


@pytest.mark.parametrize("capture", CLOUDS)
def test_points_are_those_of_nebula(data_file, capture: str) -> None:
    """Every point of a scan that nebula decoded is within 1 mm of one of ours; it leaves out some that we have."""
    sensor, packets = SENSOR[model_of(capture)], data_packets(data_file(CAPTURES[capture]))
    cloud = CLOUDS[capture]
    calibration = sensor.calibration_of(
        data_file(f"sensors/calibration/{CALIBRATIONS[model_of(capture)]}").read_bytes()
    )
    layout = sensor.layout_of(packets[0].tobytes())
    images = layout.split(packets)
    ours = []
    for name in ("range", "range2"):
        xyz = np.stack(sensor.points(SensorModel(sensor.name, calibration), layout, images, name), axis=-1)
        ours.append(xyz[images.planes[name] > 0])
    theirs = pcd_points(data_file(f"sensors/hesai/{cloud}"))
    turned = np.stack([theirs[:, 1], -theirs[:, 0], theirs[:, 2]], axis=-1)  # their x is right, their y forward
    assert _farthest(turned, np.concatenate(ours)) < NEAR_M


@pytest.mark.parametrize("name", MANUAL)
def test_sizes_and_columns_are_those_of_the_manual(name: str) -> None:
    sensor, (sizes, columns) = SENSOR[name], MANUAL[name]
    assert [layout.packet_bytes for layout in sensor.layouts] == [size for size in sizes for _ in range(2)]
    for layout in sensor.layouts:
        assert layout.columns == columns // layout.returns
        assert layout.rows == len(sensor.channel_of_row)
        assert sensor.named_layout(layout.name) is layout
    assert sensor.named_layout("triple") is None


@pytest.mark.parametrize("name", SENSOR)
def test_rows_go_from_the_top_beam_down(name: str) -> None:
    sensor = SENSOR[name]
    elevations = sensor.generic_sensor.calibration["vert_correction_rad"][sensor.channel_of_row]
    assert (np.diff(elevations) < 0).all()


@pytest.mark.parametrize("name", SENSOR)
def test_every_layout_has_times_within_a_packet_and_columns_in_order(name: str) -> None:
    sensor = SENSOR[name]
    for layout in sensor.layouts:
        packets = _made(layout, sensor, np.random.default_rng(3), 4)
        assert sensor.layout_of(packets[0].tobytes()) is layout
        images = layout.split(packets)
        assert np.array_equal(layout.join(images), packets)
        times = np.broadcast_to(sensor.times_ns(layout, images), images.planes["range"].shape)
        assert np.abs(times).max() < 1_000_000
        assert (np.diff(times[:, : layout.columns].mean(axis=0)) > 0).all()
        assert sensor.azimuth(layout, images).shape == (4 * layout.columns,)
        assert sensor.points(sensor.generic_sensor, layout, images)[0].shape == images.planes["range"].shape


def test_checksums_of_a_qt128_cost_nothing_as_long_as_they_are_right(data_file) -> None:
    packets = data_packets(data_file(CAPTURES["qt128"])).copy()
    layout = SENSOR["qt128"].layout_of(packets[0].tobytes())
    packets[7, 100] ^= 1
    packets[9, 1091] ^= 1
    images = layout.split(packets)
    assert np.flatnonzero(images.series["crc_body"]).tolist() == [7]
    assert np.flatnonzero(images.series["crc_tail"]).tolist() == [9]
    assert np.array_equal(layout.join(images), packets)


def test_packets_with_three_returns_or_another_step_are_not_taken(data_file) -> None:
    sensor = SENSOR["xt32m"]
    packet = bytearray(data_packets(data_file(CAPTURES["xt32m"]))[0].tobytes())
    mode_at = len(packet) - 4 - 24 + 10
    assert packet[mode_at] == 0x3C
    packet[mode_at] = 0x3D
    assert sensor.layout_of(bytes(packet)) is None
    packet[mode_at] = 0x37
    assert sensor.layout_of(bytes(packet)) is sensor.named_layout("single")
    packet[9] = 4
    assert sensor.layout_of(bytes(packet)) is None


def test_calibrations_are_found_beside_the_captures(data_file) -> None:
    for name, file in CALIBRATIONS.items():
        sensor, path = SENSOR[name], data_file(f"sensors/calibration/{file}")
        calibration = sensor.calibration_of(path.read_bytes())
        generic = sensor.generic_sensor.calibration
        assert np.abs(np.degrees(calibration["vert_correction_rad"] - generic["vert_correction_rad"])).max() < 0.15
        assert np.abs(np.degrees(calibration["rot_correction_rad"] - generic["rot_correction_rad"])).max() < 0.2


def _made(layout, sensor, rng: np.random.Generator, count: int) -> np.ndarray:
    """Packets of random returns with the constants of a layout."""
    packets = rng.integers(0, 256, (count, layout.packet_bytes), np.uint8)
    records = packets.view(layout.packet)[:, 0]
    for name, values in layout.constants.items():
        if name == "blocks.flag":
            records["blocks"]["flag"] = values
        else:
            records[name] = values[0]
    for name, values in layout.modes.items():
        records[name] = values[-1]
    return packets


def _farthest(points: np.ndarray, others: np.ndarray) -> float:
    """Largest distance from a point to one of the others that is within NEAR_M, or to the nearest if none is.

    Infinity if there is none in any cell beside it.
    """
    ours, mine = np.floor(others / NEAR_M).astype(np.int64), np.floor(points / NEAR_M).astype(np.int64)
    order = np.argsort(_cell(ours))
    cells, nearest = _cell(ours)[order], np.full(len(points), np.inf)
    left = np.arange(len(points))
    for step in sorted(np.ndindex(3, 3, 3), key=lambda step: sum(abs(one - 1) for one in step)):
        wanted = _cell(mine[left] + np.array(step) - 1)
        first, last = np.searchsorted(cells, wanted, "left"), np.searchsorted(cells, wanted, "right")
        for number in range(int((last - first).max(initial=0))):
            there = np.flatnonzero((first + number < last) & (nearest[left] >= NEAR_M))
            distance = np.linalg.norm(others[order[first[there] + number]] - points[left[there]], axis=1)
            nearest[left[there]] = np.minimum(nearest[left[there]], distance)
        left = left[nearest[left] >= NEAR_M]
    return float(nearest.max())


def _cell(place: np.ndarray) -> np.ndarray:
    """One number for each cell of a cubic grid of 2**20 cells a side."""
    return ((place[:, 0] + 2**19) << 40) + ((place[:, 1] + 2**19) << 20) + place[:, 2] + 2**19
