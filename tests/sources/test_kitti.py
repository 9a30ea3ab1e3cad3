"""What a user loses if these fail: KITTI drives that are not what the sensor sent, or moved points sold as such."""

from __future__ import annotations

import lzma
import struct
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from lidarcodec.assembly import Assembler
from lidarcodec.commands.info.source import inspect_source
from lidarcodec.errors import CalibrationError, SourceError, UnknownNameError
from lidarcodec.sensor_model import Calibration, SensorModel
from lidarcodec.sensors import generic_sensor, read_calibration, write_yaml
from lidarcodec.sensors.hdl64 import parse
from lidarcodec.sources import open_source
from lidarcodec.sources.kitti.grid import fit_rings, regrid
from lidarcodec.sources.kitti.inversion import Geometry, invert
from lidarcodec.sources.kitti.points import find_scans, read_points
from lidarcodec.sources.kitti.source import KittiSource
from lidarcodec.sources.unkept import unkept
from tests.sweeps import sampled

RECOVERED = "kitti_hdl64e_s2_recovered.yaml"


def invented_sensor() -> SensorModel:
    """A sensor with everything that the formula knows, like KITTI's: no data needed."""
    rings = np.arange(64)
    vertical = np.radians(np.where(rings < 32, 2.0 - rings / 3, -9.0 - (rings - 32) / 2))
    values = {
        "rot_correction_rad": np.pi - 0.15 + rings % 7 * 0.015,
        "vert_correction_rad": vertical,
        **dict.fromkeys(("dist_correction_m", "dist_correction_x_m", "dist_correction_y_m"), 0.9 + rings % 5 * 0.05),
        "vert_offset_m": np.where(rings < 32, 0.2, 0.12),
        "horiz_offset_m": np.where(rings % 2, 0.026, -0.026),
    }
    return SensorModel("HDL-64E", Calibration.from_values(values))


def turn(seed: int = 0, firings: int = 2150, seen: float = 0.85):
    """Azimuth, range and intensity of a turn, and the KITTI scan that its driver would have stored."""
    generator = np.random.default_rng(seed)
    steps = np.where(generator.random(firings) < 0.14, 9, 18)
    azimuth = np.cumsum(steps) // 9 * 9
    azimuth = azimuth[azimuth < 36000]
    native = generator.integers(800, 39_000, (len(azimuth), 64)) * (generator.random((len(azimuth), 64)) < seen)
    levels = generator.integers(0, 100, native.shape)
    sensor = invented_sensor()
    column, laser = np.nonzero(native)
    points = Geometry(sensor).project(azimuth[column].astype(float), native[column, laser].astype(float), laser)
    angle = np.arctan2(points[:, 1], points[:, 0]) % (2 * np.pi)
    order = np.lexsort((angle, sensor.ring_of_laser[laser]))
    scan = np.column_stack([np.rint(points * 1000) / 1000, levels[column, laser] / 100]).astype("<f4")[order]
    intensity = np.where(native > 0, np.rint(levels * 255 / 100), 0)
    return azimuth, native, intensity, scan


def drive(folder: Path, scans, calibration: bool = True) -> Path:
    """A KITTI raw folder."""
    data = folder / "2011_09_26_drive_0999_sync" / "velodyne_points" / "data"
    data.mkdir(parents=True)
    for number, scan in enumerate(scans):
        (data / f"{number:010d}.bin").write_bytes(scan if isinstance(scan, bytes) else scan.tobytes())
    if calibration:
        write_yaml(invented_sensor(), folder / RECOVERED)
    return data.parent.parent


def native_of(packets):
    """Azimuth, range and intensity by firing and laser, status bytes and time stamps."""
    arrays = parse([p.payload for p in packets])
    assert (arrays.flags == [0xEEFF, 0xDDFF] * 6).all()
    assert (arrays.azimuth[:, ::2] == arrays.azimuth[:, 1::2]).all()
    shape = (-1, 64)
    return arrays.azimuth[:, ::2].ravel(), arrays.distances.reshape(shape), arrays.intensities.reshape(shape), arrays


def test_a_raw_drive_becomes_one_continuous_stream_of_what_the_sensor_measured(tmp_path):
    turns = [turn(seed) for seed in range(3)]
    with open_source(drive(tmp_path, [t[3] for t in turns])) as source:
        packets = list(source.packets())
    assert source.kind == "raw"
    assert source.sensor.origin == "beside"
    assert source.sensor.hash == invented_sensor().hash
    assert all(f.within_1mm > 0.999 for f in source.fidelity)
    azimuth, ranges, intensity, _ = native_of(packets)
    count = sum(len(t[0]) for t in turns)
    assert len(packets) == -(-count // 6)
    assert np.array_equal(azimuth[:count], np.concatenate([t[0] for t in turns]))
    assert np.array_equal(ranges[:count], np.concatenate([t[1] for t in turns]))
    assert np.array_equal(intensity[:count], np.concatenate([t[2] for t in turns]))
    assert not ranges[count:].any()
    assert not intensity[count:].any()


def test_time_stamps_are_the_drives_own_and_status_bytes_tell_the_same_clock(tmp_path):
    turns = [turn(seed) for seed in range(2)]
    folder = drive(tmp_path, [t[3] for t in turns])
    points = folder / "velodyne_points"
    (points / "timestamps_start.txt").write_text("2011-09-26 13:59:59.950000000\n2011-09-26 14:00:00.053500000\n")
    (points / "timestamps_end.txt").write_text("2011-09-26 14:00:00.053500000\n2011-09-26 14:00:00.157000000\n")
    with open_source(folder) as source:
        packets = list(source.packets())
    start = int(np.datetime64("2011-09-26T13:59:59.95", "ns").astype(np.int64))
    assert source.start_ns == start
    stamps = np.array([p.stamp_ns for p in packets])
    assert 0 < stamps[0] - start < 300_000
    assert abs(stamps[-2] - start - 207_000_000) < 300_000
    assert np.diff(stamps).min() > 270_000
    assert np.diff(stamps).max() < 300_000
    _, _, _, arrays = native_of(packets)
    assert np.array_equal(arrays.gps_us, stamps // 1000 % 3_600_000_000)
    assert bytes(arrays.status[:9, 0]) == b"HMSDNYGHM"
    assert arrays.status[:7, 1].tolist() == [13, 59, 59, 26, 9, 11, 0]
    assert arrays.status[-700:][arrays.status[-700:, 0] == ord("H")][-1, 1] == 14


def test_a_folder_without_times_gets_even_turns(tmp_path):
    folder = drive(tmp_path, [turn(seed)[3] for seed in range(2)])
    stamps = np.array([p.stamp_ns for p in open_source(folder).packets()])
    assert abs(stamps[-1] - stamps[0] - 2 * 103_400_000) < 600_000
    assert all(b > a for a, b in pairwise(stamps))


def test_missing_scans_keep_their_own_times(tmp_path):
    folder = drive(tmp_path, [turn(seed)[3] for seed in range(3)])
    points = folder / "velodyne_points"
    (points / "data" / "0000000001.bin").unlink()
    lines = "".join(f"2011-09-26 13:00:{number:02d}.5\n" for number in range(3))
    (points / "timestamps.txt").write_text(lines)
    scans = find_scans(folder)
    assert [(s.start_ns + s.end_ns) // 2 % 60_000_000_000 for s in scans] == [500_000_000, 2_500_000_000]
    (points / "timestamps.txt").write_text(lines[: len(lines) // 3])
    with pytest.raises(SourceError, match="scan 2 has no time stamp"):
        find_scans(folder)
    for text in ("yesterday", "NaT"):
        (points / "timestamps.txt").write_text(f"{text}\n")
        with pytest.raises(SourceError, match=f"'{text}' is not a time"):
            find_scans(folder)
    (points / "timestamps_start.txt").write_text(lines)
    (points / "timestamps_end.txt").write_text(lines.replace("13:00", "12:59"))
    with pytest.raises(SourceError, match="end before they begin"):
        find_scans(folder)


def test_scans_are_in_the_order_of_their_numbers_and_each_is_one(tmp_path):
    """As texts 10 is before 8; and a scan beside its compressed copy came twice."""
    for name in ("8.bin", "9.bin", "10.bin", "9.bin.xz"):
        (tmp_path / name).write_bytes(bytes(16))
    assert [scan.path.name for scan in find_scans(tmp_path)] == ["8.bin", "9.bin", "10.bin"]


def test_a_raw_drive_that_begins_with_an_empty_scan_is_a_raw_drive(tmp_path):
    with open_source(drive(tmp_path, [b"", turn()[3]])) as source:
        assert "raw" in source.label
        assert list(source.packets())
        assert unkept(source.counts) == "1 scans without points"


def test_without_the_calibration_the_error_says_what_to_give_and_where(tmp_path, monkeypatch):
    folder = drive(tmp_path, [turn()[3]], calibration=False)
    monkeypatch.delenv("LIDARCODEC_DATA", raising=False)
    with pytest.raises(SourceError, match=r"kitti_hdl64e_s2_recovered.*LIDARCODEC_DATA.*kind=odometry"):
        open_source(folder)
    data = tmp_path / "elsewhere"
    data.mkdir()
    write_yaml(invented_sensor(), data / RECOVERED)
    monkeypatch.setenv("LIDARCODEC_DATA", str(data))
    assert open_source(folder).sensor.hash == invented_sensor().hash
    assert open_source(folder, calibration=data / RECOVERED).sensor.origin == "given"
    with pytest.raises(CalibrationError):
        open_source(folder, calibration=folder)


def test_a_calibration_of_another_sensor_is_noticed(tmp_path):
    folder = drive(tmp_path, [turn()[3]], calibration=False)
    write_yaml(generic_sensor("HDL-64E S2"), tmp_path / "other.yaml")
    with pytest.raises(SourceError, match=r"only 0\.\d% of its points fit"):
        open_source(folder, calibration=tmp_path / "other.yaml")


def test_moved_points_are_re_gridded_and_every_name_says_so(tmp_path, caplog):
    scan = turn()[3].copy()
    scan[:, :3] += np.array([0.0003, 0.0471, 0.0102], np.float32)
    sequence = tmp_path / "sequences" / "00"
    (sequence / "velodyne").mkdir(parents=True)
    (sequence / "velodyne" / "000000.bin").write_bytes(scan.tobytes())
    (sequence / "velodyne" / "000001.bin").write_bytes(scan.tobytes())
    (sequence / "times.txt").write_text("0.0\n1.037e-01\n")
    (sequence / "poses.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * 2)
    write_yaml(invented_sensor(), tmp_path / RECOVERED)
    with open_source(sequence, poses=sequence / "poses.txt") as source:
        packets = list(source.packets())
    assert source.kind == "odometry"
    assert "KITTI odometry, re-gridded" in source.label
    assert "KITTI odometry, re-gridded" in source.sensor.name
    assert "KITTI odometry, re-gridded" in caplog.text
    assert len(packets) == 2 * 348
    assert abs(packets[348].stamp_ns - packets[0].stamp_ns - 103_700_000) < 1000
    assert source.poses.at(source.start_ns) is not None
    assert source.counts["points in one cell"] == sum(f.in_one_cell for f in source.fidelity)
    azimuth, ranges, _, _ = native_of(packets)
    assert np.array_equal(azimuth[:2088], np.rint(np.arange(2088) * 36000 / 2088))
    assert np.count_nonzero(ranges) == 2 * len(scan) - source.counts["points in one cell"]
    assert source.caveat == "KITTI odometry, re-gridded"
    with open_source(f"{sequence}?columns=2160") as source:
        assert len(list(source.packets())) == 2 * 360


def test_of_points_in_one_cell_the_nearest_stays():
    geometry = Geometry(invented_sensor())
    near, far = (geometry.project(np.array([900.0]), np.array([d]), np.array([5])) for d in (5000.0, 9000.0))
    points = np.column_stack([np.concatenate([far, near, far]), [0.1, 0.2, 0.3]])
    for firings, fidelity in (invert(points, geometry), regrid(points, geometry)):
        assert firings.range.max() == 5000
        assert np.count_nonzero(firings.range) == 1
        assert firings.intensity.max() == 51
        assert fidelity.in_one_cell == 2


def test_points_that_no_packet_can_hold_are_counted(tmp_path):
    scan = turn()[3]
    beyond = np.array([[150.0, 0, 0, 0.5], [0.1, 0.1, 0, 0.5], [np.nan, 0, 0, 0], [np.inf, 0, 0, 0]], "<f4")
    folder = drive(tmp_path, [np.concatenate([scan, beyond]).tobytes(), b"", scan.tobytes()])
    with open_source(folder) as source:
        packets = list(source.packets())
    assert dict(source.counts) == {"bad points": 2, "points out of range": 2, "empty scans": 1}
    assert len(packets) == -(-2 * len(turn()[0]) // 6)


def test_files_that_are_no_scans_are_refused(tmp_path):
    scan = turn()[3].tobytes()
    folder = drive(tmp_path, [scan[:-3]])
    with pytest.raises(SourceError, match="not a KITTI scan"):
        open_source(folder)
    (tmp_path / "huge.bin").write_bytes(bytes(16 * (2**20 + 1)))
    with pytest.raises(SourceError, match="not a KITTI scan"):
        open_source(tmp_path / "huge.bin")
    (tmp_path / "cut.bin.xz").write_bytes(lzma.compress(scan, preset=0)[:-500])
    with pytest.raises(SourceError, match="xz data is cut"):
        open_source(tmp_path / "cut.bin.xz")
    (tmp_path / "empty").mkdir()
    with pytest.raises(SourceError, match="nor a KITTI folder"):
        open_source(tmp_path / "empty")
    with pytest.raises(UnknownNameError, match="choose one of raw, odometry"):
        open_source(f"{tmp_path}/huge.bin?kind=lidar")


def test_random_points_never_raise_anything_else(tmp_path):
    generator = np.random.default_rng(5)
    write_yaml(invented_sensor(), tmp_path / RECOVERED)
    for number in range(12):
        count = int(generator.integers(0, 3000))
        data = (
            generator.bytes(16 * count)
            if number % 2
            else (generator.normal(size=(count, 4)) * 40).astype("<f4").tobytes()
        )
        (tmp_path / "scan.bin").write_bytes(data)
        for kind in ("raw", "odometry"):
            with open_source(f"{tmp_path}/scan.bin?kind={kind}") as source:
                assert all(len(p.payload) == 1206 for p in source.packets())


def test_rings_are_fitted_to_a_scan_when_there_is_no_calibration(tmp_path):
    scan = turn()[3].astype(float)
    fitted = fit_rings(scan)
    assert fitted is not None
    truth = invented_sensor()
    error = [s.calibration["vert_correction_rad"][s.laser_of_ring] for s in (fitted, truth)]
    assert np.degrees(np.abs(error[0] - error[1]).max()) < 0.3
    assert fit_rings(scan[: len(scan) // 2]) is None
    assert fit_rings(np.zeros((0, 4))) is None


# The real drives


@pytest.fixture(scope="session")
def recovered(data_file):
    return read_calibration(data_file("kitti_hdl64e_s2_recovered_db.xml"))


@pytest.mark.parametrize(
    ("scan", "capture", "revolution"),
    [
        ("kitti_sfnd_f000.bin.xz", "kitti_sfnd_f000-049.pcap.xz", 0),
        ("kitti_sfnd_f024.bin.xz", "kitti_sfnd_f000-049.pcap.xz", 24),
    ],
)
def test_a_stored_scan_gives_the_very_firings_of_the_reconstructed_packets(
    data_file, recovered, scan, capture, revolution
):
    """The packets in the data folder were made by another program from the same points."""
    points, _ = read_points(data_file(scan))
    firings, fidelity = invert(points, Geometry(recovered))
    packets = []
    for packet in open_source(data_file(capture)).packets():
        packets.append(packet)
        if len(packets) == 360 * (revolution + 2):
            break
    azimuth, ranges, intensity, _ = native_of(packets)
    wraps = np.flatnonzero(np.diff(azimuth.astype(int)) < 0) + 1
    edges = [0, *wraps] if ranges[: wraps[0]].any() else wraps  # the file begins with padding
    part = slice(edges[revolution], edges[revolution + 1])
    assert np.array_equal(azimuth[part], firings.azimuth)
    assert np.array_equal(ranges[part], firings.range)
    assert np.array_equal(intensity[part], firings.intensity)
    assert fidelity.within_1mm == 1.0
    assert fidelity.worst_mm < 1.0
    assert fidelity.equal > 0.94


def test_a_lost_packet_is_a_jump_of_the_rotation(data_file, recovered):
    points, _ = read_points(data_file("kitti_sfnd_f024.bin.xz"))
    steps = np.diff(invert(points, Geometry(recovered))[0].azimuth.astype(int))
    assert sorted(set(steps.tolist())) == [9, 18, 117]
    assert np.count_nonzero(steps == 117) == 1


def test_real_raw_and_odometry_scans_are_told_apart(data_file, monkeypatch):
    monkeypatch.setenv("LIDARCODEC_DATA", str(data_file("manifest.json").parent))
    raw, odometry = data_file("kitti_0005_f100.bin.xz"), data_file("kitti_odometry_00_000094.bin.xz")
    assert open_source(raw).kind == "raw"
    with open_source(odometry) as source:
        assert source.kind == "odometry"
        assert len(list(source.packets())) == 348
    fidelity = source.fidelity[0]
    assert fidelity.within_1mm < 0.01
    assert fidelity.worst_mm < 250.0
    assert fidelity.in_one_cell < 0.12 * fidelity.points
    assert KittiSource(raw, kind="odometry").kind == "odometry"


@pytest.mark.parametrize(
    ("name", "far_mm"),
    sampled(
        [("kitti_sfnd_f000.bin.xz", 1.0), ("kitti_odometry_00_000001.bin.xz", 130.0)],
        [("kitti_sfnd_f000.bin.xz", 1.0)],
    ),
)
def test_the_cloud_of_the_frame_lies_on_the_stored_points(data_file, monkeypatch, name, far_mm):
    monkeypatch.setenv("LIDARCODEC_DATA", str(data_file("manifest.json").parent))
    with open_source(data_file(name)) as source:
        assembler = Assembler(source.sensor, "packets:360")
        frames = [frame for packet in source.packets() if (frame := assembler.push(packet))]
        frames += [frame] if (frame := assembler.flush()) else []
    assert len(frames) == 1
    cloud = frames[0].cloud()
    points, _ = read_points(data_file(name))
    assert len(cloud) == len(points) - source.fidelity[0].in_one_cell
    for point in cloud[:: len(cloud) // 200]:
        away = np.linalg.norm(points[:, :3] - [float(point[axis]) for axis in "xyz"], axis=1)
        assert away.min() * 1000 < far_mm


def test_info_prints_the_fidelity_of_every_scan(tmp_path):
    folder = drive(tmp_path, [turn(seed)[3] for seed in range(2)])
    rows = inspect_source(str(folder), None)["fidelity"]
    assert [row["within_1mm"] for row in rows] == [1.0, 1.0]
    assert all(0.9 < row["equal"] <= 1.0 and row["worst_mm"] < 1.0 and row["points"] > 100_000 for row in rows)


def test_an_odometry_scan_without_calibration_is_gridded_as_well_as_with_it(data_file, recovered):
    points, _ = read_points(data_file("kitti_odometry_00_000000.bin.xz"))
    fitted = fit_rings(points)
    assert fitted is not None
    with_it, without = (regrid(points, Geometry(sensor))[1] for sensor in (recovered, fitted))
    assert without.in_one_cell < 1.05 * with_it.in_one_cell
    assert without.worst_mm < 1.2 * with_it.worst_mm


def test_sixteen_bytes_a_point(tmp_path):
    (tmp_path / "one.bin").write_bytes(struct.pack("<4f", 1, 2, 3, 0.5))
    points, bad = read_points(tmp_path / "one.bin")
    assert points.tolist() == [[1, 2, 3, 0.5]]
    assert bad == 0
