"""What `decode` writes is read here by other programs' readers: a file that only we can read is worth nothing."""

import dataclasses
import json
import os
import threading

import dpkt
import laspy
import numpy as np
import pypcd4
import pytest

import lidarcodec
from lidarcodec.commands.outputs.table import FORMS, check_output, contents_of, form_of, open_output
from lidarcodec.errors import SettingsError
from lidarcodec.files.whole import whole
from lidarcodec.pipeline import frames_of
from tests.command_line import run_here
from tests.packets import sensor, turning


@pytest.fixture
def frames():
    return list(frames_of(turning(60), sensor(), "packets:29"))


@pytest.fixture
def written(frames, tmp_path):
    def write(name, form=None):
        path = tmp_path / name
        made_as = form_of(path, form, folder="kitti")
        with whole(path, contents=contents_of(path, made_as)) as made:
            output = open_output(path, made_as, made.beside)
            for frame in frames:
                output.write(frame, frame.cloud())
            output.close()
        return path

    return write


def test_pcap_holds_the_packets_and_their_times(written):
    packets = turning(60)
    with written("out.pcap").open("rb") as file:
        found = [
            (round(stamp * 10**9), dpkt.ethernet.Ethernet(data).data.data) for stamp, data in dpkt.pcap.Reader(file)
        ]
    assert [stamp for stamp, _ in found] == [packet.stamp_ns for packet in packets]
    assert [bytes(udp.data) for _, udp in found] == [packet.payload for packet in packets]
    assert {udp.dport for _, udp in found} == {2368}


def test_npz_holds_the_images_as_they_are(written, frames):
    found = np.load(written("out.npz"))
    for number, frame in enumerate(frames):
        for name in ("range", "intensity", "azimuth", "fired"):
            np.testing.assert_array_equal(found[f"{number:06d}/{name}"], getattr(frame, name))
        assert found[f"{number:06d}/stamp_ns"] == frame.stamp_ns
        calibration = found[f"calibration/{found[f'{number:06d}/calibration']}"]
        np.testing.assert_array_equal(calibration, frame.sensor.calibration.table)
    assert len(found["calibration/fields"]) == len(found["calibration/steps"]) == len(calibration)


def read_ply(path):
    head, _, body = path.read_bytes().partition(b"end_header\n")
    names = {"float": "<f4", "double": "<f8", "uchar": "u1", "int": "<i4"}
    words = [line.split() for line in head.decode().splitlines()]
    count = next(int(line[2]) for line in words if line[:2] == ["element", "vertex"])
    dtype = np.dtype([(line[2], names[line[1]]) for line in words if line[0] == "property"])
    assert len(body) == count * dtype.itemsize
    return np.frombuffer(body, dtype)


def test_ply_holds_every_point_of_every_frame(written, frames):
    found = read_ply(written("out.ply"))
    clouds = [frame.cloud() for frame in frames]
    assert len(found) == sum(map(len, clouds))
    for name in ("x", "y", "z", "intensity", "laser", "ring"):
        np.testing.assert_array_equal(found[name], np.concatenate([cloud[name] for cloud in clouds]))
    np.testing.assert_array_equal(
        found["frame"], np.repeat([frame.index for frame in frames], [len(cloud) for cloud in clouds])
    )
    times = np.concatenate([cloud["t_ns"] for cloud in clouds]) - frames[0].stamp_ns
    np.testing.assert_allclose(found["t"], times * 1e-9, atol=1e-9)


def test_las_holds_every_point_to_the_millimetre(written, frames):
    found = laspy.read(written("out.las"))
    cloud = np.concatenate([frame.cloud() for frame in frames])
    assert len(found.points) == len(cloud)
    for axis in "xyz":
        np.testing.assert_allclose(found[axis], cloud[axis], atol=0.000501)
    np.testing.assert_array_equal(found.intensity // 257, cloud["intensity"])
    np.testing.assert_array_equal(found.point_source_id, cloud["laser"])
    assert found.header.global_encoding.gps_time_type is laspy.header.GpsTimeType.STANDARD
    assert found.header.global_encoding.wkt  # asked for by LAS 1.4 with this point format
    ahead_s = 18  # of GPS before UTC since 2017
    np.testing.assert_allclose(
        found.gps_time, cloud["t_ns"] * 1e-9 - 315_964_800 - 1_000_000_000 + ahead_s, rtol=0, atol=1e-6
    )


def test_laz_holds_the_same_in_fewer_bytes(written):
    plain, packed = written("out.las"), written("out.laz")
    assert packed.stat().st_size < plain.stat().st_size
    np.testing.assert_array_equal(laspy.read(packed).points.array, laspy.read(plain).points.array)


@pytest.mark.parametrize("form", ["pcd", "pcd-compressed"])
def test_pcd_is_read_by_pypcd4(written, frames, form):
    path = written("out.pcd", form)
    found = pypcd4.PointCloud.from_path(path)
    cloud = np.concatenate([frame.cloud() for frame in frames])
    assert path.read_bytes().count(b"DATA binary\n" if form == "pcd" else b"DATA binary_compressed\n") == 1
    assert found.fields == ("x", "y", "z", "intensity", "laser", "ring", "frame", "t")
    for name in ("x", "y", "z", "intensity", "laser", "ring"):
        np.testing.assert_array_equal(found.pc_data[name], cloud[name])
    assert set(found.pc_data["frame"]) == {0, 1, 2}
    assert found.types[:4] == (np.float32,) * 4  # of another type, PCL's PointXYZI reads every intensity as 0


def test_csv_has_a_line_for_each_point(written, frames):
    found = np.genfromtxt(written("out.csv"), delimiter=",", names=True, dtype=None, encoding="ascii")
    cloud = np.concatenate([frame.cloud() for frame in frames])
    assert found.dtype.names == ("x_m", "y_m", "z_m", "intensity", "laser", "ring", "frame", "t_ns")
    for axis in "xyz":
        np.testing.assert_allclose(found[f"{axis}_m"], cloud[axis], atol=6e-5)
    for name in ("intensity", "laser", "ring", "t_ns"):
        np.testing.assert_array_equal(found[name], cloud[name])


def test_e57_is_read_by_pye57(written, frames):
    pye57 = pytest.importorskip("pye57", reason="it has no wheel for this processor")
    file = pye57.E57(str(written("out.e57")))
    assert file.scan_count == len(frames)
    for number, frame in enumerate(frames):
        found, cloud = file.read_scan_raw(number), frame.cloud()
        for axis in "xyz":
            np.testing.assert_array_equal(found[f"cartesian{axis.upper()}"], cloud[axis].astype(np.float64))
        np.testing.assert_array_equal(found["intensity"], cloud["intensity"])
        np.testing.assert_array_equal(found["rowIndex"], cloud["ring"])
    file.close()


@pytest.mark.parametrize(
    ("form", "ending"), [("ply", ".ply"), ("laz", ".laz"), ("pcd-compressed", ".pcd"), ("npz", ".npz")]
)
def test_a_folder_holds_a_file_for_each_frame_of_any_format(written, frames, form, ending):
    folder = written("each", form)
    assert sorted(one.name for one in folder.iterdir()) == [*(f"{n:06d}{ending}" for n in range(3)), "timestamps.json"]
    if form == "ply":
        assert [len(read_ply(folder / f"{n:06d}.ply")) for n in range(3)] == [frame.points for frame in frames]


def test_a_folder_gets_a_scan_for_each_frame_as_kitti_orders_them(written, frames):
    folder = written("scans")
    stamps = json.loads((folder / "timestamps.json").read_text())
    assert list(stamps) == ["000000.bin", "000001.bin", "000002.bin"]
    assert list(stamps.values()) == [frame.stamp_ns for frame in frames]
    for name, frame in zip(stamps, frames, strict=True):
        rows = np.fromfile(folder / name, "<f4").reshape(-1, 4)
        cloud = frame.cloud()
        cloud = cloud[np.argsort(cloud["ring"], kind="stable")]
        np.testing.assert_array_equal(rows[:, 0], cloud["x"])
        np.testing.assert_array_equal(np.rint(rows[:, 3] * 255), cloud["intensity"])


def test_an_ending_that_nobody_writes_is_refused_before_anything_is_read(tmp_path):
    with pytest.raises(SettingsError, match=r"\.las"):
        form_of(tmp_path / "cloud.obj")


@pytest.mark.parametrize("name", ["out.pcap", "out.npz", "out.ply", "out.las", "out.pcd", "out.csv", "scans"])
def test_an_output_has_its_name_when_it_is_whole_and_not_before(written, frames, tmp_path, name):
    path = tmp_path / name
    form = form_of(path, folder="kitti")

    def breaks(made):
        open_output(path, form, made.beside).write(frames[0], frames[0].cloud())
        assert not path.exists()
        raise ValueError("broken")

    with pytest.raises(ValueError, match="broken"), whole(path, contents=contents_of(path, form)) as made:
        breaks(made)
    assert list(tmp_path.iterdir()) == []
    written(name)
    assert [one.name for one in tmp_path.iterdir()] == [name]


def test_scans_do_not_mix_with_what_is_in_a_folder(written, tmp_path):
    folder = written("scans")
    with pytest.raises(SettingsError, match="not empty"):
        check_output(folder, FORMS["kitti"])
    check_output(folder, FORMS["kitti"], force=True)
    (folder / "metadata.yaml").write_text("mine")
    with pytest.raises(SettingsError, match=r"metadata\.yaml"):
        check_output(folder, FORMS["kitti"], force=True)
    (tmp_path / "empty").mkdir()
    check_output(tmp_path / "empty", FORMS["kitti"])


def test_what_a_form_cannot_hold_is_said(frames, tmp_path):
    frame = frames[0]
    with pytest.raises(SettingsError, match=r"too large for \.ply"):
        FORMS["ply"].open(tmp_path / "out.ply").write(frame.with_(index=2**40), frame.cloud())
    far = frame.with_(sensor=dataclasses.replace(frame.sensor, range_step_m=429.0))
    with pytest.raises(SettingsError, match="too far away"):
        FORMS["las"].open(tmp_path / "out.las").write(far, far.cloud())


@pytest.mark.parametrize("words", [("encode",), ("convert", "--as", "recording"), ("convert", "--as", "packets")])
def test_a_recording_goes_through_a_pipe_and_is_the_same(words, tmp_path):
    pipe = tmp_path / "pipe.mcap"
    os.mkfifo(pipe)
    came: list[bytes] = []
    reader = threading.Thread(target=lambda: came.append(pipe.read_bytes()), daemon=True)
    reader.start()
    command, *more = words
    for out in (pipe, tmp_path / "file.mcap"):
        done = run_here(command, "sim:city?frames=1", str(out), *more)
        assert done.returncode == 0, done.stderr
    reader.join(30)
    assert [frame.points for frame in lidarcodec.read_frames(saved(tmp_path / "came.mcap", came[0]))] == [
        frame.points for frame in lidarcodec.read_frames(tmp_path / "file.mcap")
    ]
    assert len(came[0]) == (tmp_path / "file.mcap").stat().st_size


def saved(path, data: bytes):
    """The path, with these bytes there."""
    path.write_bytes(data)
    return path
