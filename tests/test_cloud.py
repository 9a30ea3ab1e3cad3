"""What a user would lose here: points where the sensor's makers, KITTI and the ROS driver put them."""

from __future__ import annotations

import lzma
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import velodyne_decoder as vd

import lidarcodec
from lidarcodec.assembly import Assembler
from lidarcodec.cloud import CLOUD_DTYPE, second_cloud, second_returns
from lidarcodec.errors import SectionError
from lidarcodec.frame import Frame
from lidarcodec.packet import Packet
from lidarcodec.sensor_model import CALIBRATION_FIELDS, Calibration, SensorModel
from lidarcodec.sensors import generic_sensor, read_calibration, ros_yaml
from tests.packets import LOWER, UPPER, payload, read_plain_pcap, turning
from tests.packets import sensor as angles_only

Points = npt.NDArray[np.float64]


def whole(sensor: SensorModel, packets: list[Packet]) -> Frame:
    """All packets as one frame."""
    assembler = Assembler(sensor, f"packets:{len(packets)}")
    frames = [frame for packet in packets if (frame := assembler.push(packet))]
    assert len(frames) == 1
    return frames[0]


def spaced(packets: list[Packet]) -> list[Packet]:
    """The packets a millisecond apart, so that every block has a time of its own."""
    return [Packet(packet.payload, 1_000_000 * number) for number, packet in enumerate(packets)]


def xyz(points: npt.NDArray[np.void]) -> Points:
    return np.stack([points[name] for name in "xyz"], axis=1).astype(np.float64)


def changed(sensor: SensorModel, **values: npt.ArrayLike) -> SensorModel:
    """The sensor with some calibration values replaced."""
    kept: dict[str, npt.ArrayLike] = {name: sensor.calibration[name] for name in CALIBRATION_FIELDS}
    return SensorModel(sensor.name, Calibration.from_values(kept | values), "given", sensor.convention)


def test_the_real_capture_gives_velodynes_own_points(data_file) -> None:
    """Residual against the 89,105 points of the reference file: all within 8 um, half of them within 0.1 um.

    Their form is `veloview`; x is right and y forward there. The revolution begins at block 1 of packet 42.
    """
    sensor = read_calibration(data_file("hdl64e_s3_atwall_db.xml")).with_convention("veloview")
    packets = spaced(read_plain_pcap(data_file("hdl64e_s3_atwall.pcap"))[42:])
    points = whole(sensor, packets).cloud()
    # The file is in packet order; here, a column holds the lower block before the upper one that joined it.
    points = points[np.lexsort((points["laser"], points["laser"] < 32, points["t_ns"]))]
    points = points[np.count_nonzero((points["t_ns"] == points["t_ns"][0]) & (points["laser"] >= 32)) :]
    with lzma.open(data_file("hdl64e_s3_atwall_frame1.csv.xz"), "rt") as file:
        reference = np.loadtxt(file, delimiter=",", skiprows=1)
    points = points[: len(reference)]
    assert np.array_equal(points["intensity"], reference[:, 3])
    error = np.abs(np.stack([-points["y"], points["x"], points["z"]], axis=1) - reference[:, :3]).max(axis=1)
    assert error.max() < 8e-6
    assert np.median(error) < 1e-7


def test_kitti_packets_give_the_stored_kitti_scan(data_file) -> None:
    """Residual against the 114,278 stored points: all within 0.71 mm; they were stored rounded to millimetres."""
    sensor = read_calibration(data_file("kitti_hdl64e_s2_recovered_db.xml"))
    frame = whole(sensor, read_plain_pcap(data_file("kitti_sfnd_f000-049.pcap.xz"))[:400])
    first, second = np.flatnonzero(np.diff(frame.azimuth[0].astype(int)) < -18000)[:2] + 1
    column = np.flatnonzero(frame.valid.T) // 64
    points = frame.cloud()[(column >= first) & (column < second)]
    stored = np.frombuffer(lzma.decompress(data_file("kitti_sfnd_f000.bin.xz").read_bytes()), "<f4").reshape(-1, 4)
    assert len(points) == len(stored)
    turn = np.arctan2(points["y"].astype(np.float64), points["x"].astype(np.float64)) % (2 * np.pi)
    points = points[np.lexsort((turn, points["ring"]))]  # KITTI's order: ring by ring, by rising angle
    assert np.abs(xyz(points) - stored[:, :3]).max() < 0.71e-3
    assert np.array_equal(np.round(points["intensity"] / 255.0, 2).astype(np.float32), stored[:, 3])


def standing(azimuths: npt.NDArray[np.int64], seed: int = 2) -> list[Packet]:
    """Packets with one azimuth each, for decoders that spread a packet's azimuths by firing time.

    seed: nothing nearer than 30 mm, because velodyne-decoder leaves out what is 6 mm off
    """
    rng = np.random.default_rng(seed)
    return spaced([Packet(payload([(UPPER, int(a)), (LOWER, int(a))] * 6, rng), 0) for a in azimuths])


def config_of(sensor: SensorModel, path: Path) -> vd.Config:
    path.write_text(ros_yaml.text(sensor.calibration))
    calibration = vd.Calibration.read(str(path))
    return vd.Config(model=vd.Model.HDL64E_S2, calibration=calibration, min_range=0, max_range=200)


def as_velodyne_decoder(sensor: SensorModel, packets: list[Packet], path: Path) -> Points:
    """x, y, z by packet, block and laser, as velodyne-decoder has it."""
    config = config_of(sensor, path)
    points = []
    for packet in packets:
        scan = vd.PacketVector([vd.VelodynePacket(packet.stamp_ns / 1e9, packet.payload)])
        points.append(vd.ScanDecoder(config).decode(scan)[1][:, :3])
    return np.concatenate(points).astype(np.float64)


def nearest(ours: Points, theirs: Points) -> npt.NDArray[np.float64]:
    """Distance of each of our points to the nearest of theirs, packet by packet."""
    assert len(ours) == len(theirs)
    return np.sqrt(((ours[:, None] - theirs[None]) ** 2).sum(axis=2)).min(axis=1)


@pytest.mark.parametrize("convention", ["ros", "veloview"])
@pytest.mark.parametrize("file", ["kitti_hdl64e_s2_recovered_db.xml", "hdl64e_s3_atwall_db.xml"])
def test_velodyne_decoder_agrees(data_file, tmp_path: Path, convention: str, file: str) -> None:
    """velodyne-decoder 3.1 has the `veloview` form; for `ros`, it gets offsets and distances converted."""
    sensor = read_calibration(data_file(file))
    dist = sensor.calibration["dist_correction_m"]
    sensor = changed(sensor, dist_correction_x_m=dist, dist_correction_y_m=dist).with_convention(convention)
    packets = standing(np.arange(0, 36000, 1499))
    theirs = sensor
    if convention == "ros":
        vertical, offset = (sensor.calibration[name] for name in ("vert_correction_rad", "vert_offset_m"))
        turned = dist - offset * np.tan(vertical)
        fields = ("dist_correction_m", "dist_correction_x_m", "dist_correction_y_m")
        theirs = changed(sensor, vert_offset_m=offset / np.cos(vertical), **dict.fromkeys(fields, turned))
    for packet in packets:
        ours = xyz(whole(sensor, [packet]).cloud())
        error = nearest(ours, as_velodyne_decoder(theirs, [packet], tmp_path / "c.yaml"))
        assert error.max() < 1e-4  # 0.08 mm, at 131 m: their angles have 24 bits


def ros_driver(sensor: SensorModel, laser: int, azimuth: int, distance: int) -> tuple[float, float, float]:
    """One point, written down in the steps of the ROS driver's documentation and manual, with libm."""
    k = {name: float(sensor.calibration[name][laser]) for name in CALIBRATION_FIELDS}
    beta = np.radians(azimuth / 100) - k["rot_correction_rad"]
    cos_v, sin_v = np.cos(k["vert_correction_rad"]), np.sin(k["vert_correction_rad"])
    far = k["dist_correction_m"]

    def flat(correction: float) -> float:
        return float((distance * 0.002 + correction) * cos_v - k["vert_offset_m"] * sin_v)

    def between(near: float, at: float, near_at: float) -> float:
        return near + (far - near) * (min(abs(at), 25.04) - near_at) / (25.04 - near_at)

    across = flat(far) * np.sin(beta) - k["horiz_offset_m"] * np.cos(beta)
    along = flat(far) * np.cos(beta) + k["horiz_offset_m"] * np.sin(beta)
    across_by = between(k["dist_correction_x_m"], across, 2.4)
    along_by = between(k["dist_correction_y_m"], along, 1.93)
    right = flat(across_by) * np.sin(beta) - k["horiz_offset_m"] * np.cos(beta)
    forward = flat(along_by) * np.cos(beta) + k["horiz_offset_m"] * np.sin(beta)
    up = (distance * 0.002 + along_by) * sin_v + k["vert_offset_m"] * cos_v
    return forward, -right, up


def test_two_point_correction_point_by_point(data_file) -> None:
    sensor = read_calibration(data_file("hdl64e_s3_atwall_db.xml"))
    rng = np.random.default_rng(11)
    packets = [Packet(payload([(f, int(a)) for a in rng.integers(0, 36000, 6) for f in (UPPER, LOWER)], rng), 0)]
    frame = whole(sensor, packets)
    frame = frame.with_(
        range=np.where(frame.range > 0, frame.range // (1 + 9 * (np.arange(64) % 2))[:, None], 0).astype(np.uint16)
    )
    points = frame.cloud()
    column, ring = np.divmod(np.flatnonzero(frame.valid.T), 64)
    lasers = sensor.laser_of_ring[ring]
    expected = [
        ros_driver(sensor, int(laser), int(frame.azimuth[laser // 32, c]), int(frame.range[r, c]))
        for laser, c, r in zip(lasers, column, ring, strict=True)
    ]
    assert np.abs(xyz(points) - np.array(expected)).max() < 1e-5
    plain = changed(
        sensor, **dict.fromkeys(("dist_correction_x_m", "dist_correction_y_m"), sensor.calibration["dist_correction_m"])
    )
    assert np.abs(xyz(points) - xyz(frame.with_(sensor=plain).cloud())).max() > 0.01


def test_order_fields_and_dropped_returns() -> None:
    sensor = generic_sensor("HDL-64E S3")
    frame = whole(sensor, turning(29))
    keep = np.random.default_rng(1).random(frame.range.shape) < 0.5
    points = frame.with_(keep=keep).cloud()
    assert points.dtype == CLOUD_DTYPE
    column, ring = np.divmod(np.flatnonzero((frame.range.T > 0) & keep.T), 64)
    assert np.array_equal(points["ring"], ring)
    assert np.array_equal(points["laser"], sensor.laser_of_ring[ring])
    assert np.array_equal(points["intensity"], frame.intensity[ring, column])
    assert np.array_equal(points["t_ns"], frame.stamp_ns + column // 6 * 288_000 + column % 6 * 48_000)


def test_frames_that_never_were_packets_have_points_too() -> None:
    frame = whole(generic_sensor(), turning(10)).with_(side=None)
    points = frame.cloud()
    assert len(points) == frame.points
    assert np.array_equal(points["t_ns"], frame.stamp_ns + np.flatnonzero(frame.valid.T) // 64 * 48_000)
    empty = frame.with_(range=np.zeros_like(frame.range))
    assert empty.cloud().shape == (0,)
    images = [np.zeros((rows, 0), dtype) for rows, dtype in ((64, "u2"), (64, "u1"), (2, "u2"), (2, "?"))]
    nothing = Frame(0, 0, *images, sensor=generic_sensor())
    assert nothing.cloud().shape == (0,)


def test_blocks_of_older_firmware_are_24_us_apart() -> None:
    rng = np.random.default_rng(2)
    order = [LOWER, UPPER, UPPER, UPPER] * 3
    frame = whole(generic_sensor("HDL-64E S3"), [Packet(payload([(f, 9 * k) for k, f in enumerate(order)], rng), 500)])
    times = np.unique(frame.cloud()["t_ns"]) - 500
    assert set(times.tolist()) <= set(range(0, 288_000, 24_000))
    assert times.max() == 264_000


def dual(sensor: SensorModel) -> tuple[Frame, npt.NDArray[np.uint8]]:
    """A dual-return packet, and its blocks."""
    rng = np.random.default_rng(4)
    blocks = [(flag, azimuth) for azimuth in (100, 118, 136) for flag in (UPPER, LOWER) * 2]
    data = payload(blocks, rng)
    return whole(sensor, [Packet(data, 0)]), np.frombuffer(data[:1200], np.uint8).reshape(12, 100)


def test_second_returns_are_a_cloud_of_their_own() -> None:
    frame, blocks = dual(generic_sensor())
    assert frame.width == 3
    points = second_cloud(frame)
    swapped = blocks.reshape(3, 2, 200)[:, ::-1].tobytes() + bytes(6)
    expected = whole(generic_sensor(), [Packet(swapped, 0)]).cloud()
    key = ("t_ns", "laser")
    assert np.array_equal(np.sort(points, order=key), np.sort(expected, order=key))
    assert set(points["t_ns"].tolist()) == {0, 48_000, 96_000}


def test_velodyne_decoder_takes_the_same_returns_for_second_ones(tmp_path: Path) -> None:
    plain = angles_only()  # all conventions agree on it
    frame, blocks = dual(plain)
    scan = vd.PacketVector([vd.VelodynePacket(0.0, blocks.tobytes() + bytes(6))])
    theirs = vd.ScanDecoder(config_of(plain, tmp_path / "c.yaml")).decode(scan, as_pcl_structs=True)[1]
    for points, kind in ((frame.cloud(), vd.ReturnMode.STRONGEST), (second_cloud(frame), vd.ReturnMode.LAST)):
        found = theirs[theirs["return_type"] == kind.value]
        # They turn each laser by its firing time, so heights and distances are compared.
        order, their_order = np.lexsort((points["z"],)), np.lexsort((found["z"],))
        assert np.allclose(points["z"][order], found["z"][their_order], atol=1e-4)
        flat, their_flat = np.hypot(points["x"], points["y"]), np.hypot(found["x"], found["y"])
        assert np.allclose(flat[order], their_flat[their_order], atol=1e-4)


def test_second_returns_that_belong_nowhere_are_refused() -> None:
    frame, _ = dual(generic_sensor())
    assert second_cloud(frame.with_(side=None)).shape == (0,)
    assert second_cloud(whole(generic_sensor(), turning(2))).shape == (0,)
    wide = np.zeros((64, 2), np.uint16)
    with pytest.raises(SectionError, match="second returns"):
        second_cloud(frame.with_(range=wide, intensity=wide.astype(np.uint8), azimuth=wide[:2], fired=wide[:2] > 0))


@pytest.mark.parametrize("sensor", ["vlp16&returns=dual", "os0-32&profile=rng19_rfl8_sig16_nir16_dual", "hdl64e"])
def test_second_returns_are_counted_as_the_cloud_of_all_has_them(sensor):
    frame = next(iter(lidarcodec.read_frames(f"sim:garage?sensor={sensor}&frames=1")))
    assert second_returns(frame) == len(frame.cloud("all")) - len(frame.cloud())
    assert (second_returns(frame) > 0) == (sensor != "hdl64e")
