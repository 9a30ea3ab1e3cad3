"""What a user loses if these fail: poses at the wrong time or in the wrong frame, and every map built from them."""

from __future__ import annotations

import io
import math

import numpy as np
import pytest

from lidarcodec.errors import SourceError
from lidarcodec.sources.posed import posed
from lidarcodec.sources.poses import Poses, read_poses
from tests.contracts.frames import scene


def turned(degrees: float, x: float = 0.0) -> np.ndarray:
    """A pose turned about z, at x."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return np.array([[c, -s, 0, x], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], float)


def random_rotation(generator: np.random.Generator) -> np.ndarray:
    turn = np.linalg.qr(generator.normal(size=(3, 3)))[0]
    return turn * np.sign(np.linalg.det(turn))


def test_between_two_moments_the_way_is_straight_and_the_turn_even():
    poses = Poses(np.array([1000, 2000]), np.stack([turned(170), turned(-170, 4.0)]))
    for part in (0.0, 0.25, 0.5, 1.0, 1.5, -0.5):
        assert np.allclose(poses.at(1000 + int(part * 1000)), turned(170 + 20 * part, 4 * part), atol=1e-12)


def test_far_outside_nothing_is_known():
    poses = Poses(np.array([1000, 2000]), np.stack([turned(0), turned(1)]))
    assert poses.at(3000) is not None
    assert poses.at(0) is not None
    assert poses.at(3001) is None
    assert poses.at(-1) is None
    assert Poses(np.array([5]), turned(3)[None]).at(6) is None
    assert np.allclose(Poses(np.array([5]), turned(3)[None]).at(5), turned(3))


def test_every_rotation_comes_back_exactly():
    generator = np.random.default_rng(3)
    matrices = np.tile(np.eye(4), (200, 1, 1))
    matrices[:, :3, :3] = [random_rotation(generator) for _ in range(200)]
    matrices[0, :3, :3] = np.diag([1, -1, -1])  # half turns, where other formulas divide by zero
    matrices[1, :3, :3] = np.diag([-1, 1, -1])
    matrices[2, :3, :3] = np.diag([-1, -1, 1])
    poses = Poses(np.arange(200), matrices)
    assert max(np.abs(poses.at(k) - matrices[k]).max() for k in range(200)) < 1e-12


def test_the_data_folders_poses_give_each_frame_its_own(data_file):
    path = data_file("kitti_0005_poses.npz")
    poses = read_poses(path)
    with np.load(path) as file:
        stamps = np.rint(file["velo_mid"] * 1e9).astype(np.int64)
        errors = [np.abs(poses.at(int(t)) - T).max() for t, T in zip(stamps, file["T_world_velo"], strict=True)]
    assert len(poses) == 153
    assert max(errors) < 1e-4  # the quarter microsecond of a float64 of seconds
    assert not poses.relative


def test_poses_without_times_begin_with_the_stream(data_file, caplog):
    poses = read_poses(data_file("kitti_tracking0006_f000-010_poses.npz"))
    assert poses.relative
    assert "has no times" in caplog.text
    assert poses.at(10**18) is None
    assert poses.starting(10**18).at(10**18 + 51_700_000) is not None


def test_tum_files(tmp_path):
    path = tmp_path / "odometry.txt"
    half = math.sqrt(0.5)
    path.write_text(f"# time x y z qx qy qz qw\n1700000000.25 1 2 3 0 0 0 1\n\n1700000001.25 1 2 3 0 0 {half} {half}\n")
    pose = read_poses(path).at(1_700_000_000_750_000_000)
    assert np.allclose(pose[:3, :3], turned(45)[:3, :3], atol=1e-6)
    assert np.allclose(pose[:3, 3], [1, 2, 3])


def test_kitti_odometry_poses_are_carried_from_the_camera_to_the_sensor(tmp_path):
    """KITTI's camera looks along its z axis: a drive forward is x for the sensor."""
    T_camera_velo = np.array([[0, -1, 0, 0.0], [0, 0, -1, -0.08], [1, 0, 0, -0.27]])
    row = " ".join
    (tmp_path / "poses.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0 0 1 0 0 0 0 1 2.5\n")
    (tmp_path / "times.txt").write_text("0.0\n0.1\n")
    (tmp_path / "calib.txt").write_text("P0: 1 2\nTr: " + row(map(str, T_camera_velo.ravel())) + "\n")
    poses = read_poses(tmp_path / "poses.txt").starting(7_000_000_000)
    assert np.allclose(poses.at(7_000_000_000), np.eye(4), atol=1e-12)
    assert np.allclose(poses.at(7_100_000_000), turned(0, 2.5), atol=1e-12)


@pytest.mark.parametrize(
    ("name", "data", "match"),
    [
        ("a.txt", b"1 2 3\n", "8 numbers"),
        ("a.txt", b"", "is empty"),
        ("a.txt", b"\xff\xfe\x00", "cannot read poses from .*: it is not a text file"),
        ("a.txt", b"1 2 x 4 5 6 7 8\n", "cannot read poses"),
        ("a.txt", b"1 0 0 0 0 0 0 2\n", "length 1"),
        ("a.txt", b"nan 0 0 0 0 0 0 1\n", "seconds since"),
        ("a.txt", b"2 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n", "must increase"),
        ("a.txt", b"2 0 0 0 0 0 0 0 0 0 0 1\n", "rigid"),
        ("a.npz", b"no zip", "cannot read poses"),
    ],
)
@pytest.mark.filterwarnings("error")
def test_files_that_are_no_poses_are_refused_with_a_reason(tmp_path, name, data, match):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(SourceError, match=match):
        read_poses(tmp_path / name)


def test_a_mirrored_or_unreadable_npz_is_refused(tmp_path):
    for arrays, match in (
        ({"T_world_velo": np.diag([1.0, 1, -1, 1])[None]}, "mirrored"),
        ({"T_world_velo": np.zeros((2, 3))}, "F, 4, 4"),
        ({"T": np.zeros(3)}, "T_world_velo"),
        ({"T_world_velo": np.array([None])}, "cannot read poses"),
    ):
        file = io.BytesIO()
        np.savez(file, **arrays)
        (tmp_path / "a.npz").write_bytes(file.getvalue())
        with pytest.raises(SourceError, match=match):
            read_poses(tmp_path / "a.npz")
    with pytest.raises(SourceError, match="cannot read poses"):
        read_poses(tmp_path / "nothing.npz")


def test_poses_of_another_time_are_told_once(caplog):
    """A drive was encoded with the poses of another one: no frame had any, and nobody said so."""
    poses = Poses(np.array([0, 10**9]), np.stack([np.eye(4)] * 2))
    frame = scene(1)
    assert [posed(frame, poses).pose for _ in range(3)] == [None] * 3
    (record,) = caplog.records
    assert "1970-01-01T00:00:00.000 UTC to 1970-01-01T00:00:01.000 UTC" in record.message


def rows(*moments):
    """Poses at 10 Hz and 10 m/s, of these tenths of a second alone."""
    places = np.array(moments, np.float64)
    return Poses(np.array(moments) * 10**8, np.stack([turned(0, at) for at in places]))


def test_in_a_hole_over_which_the_sensor_moved_nothing_is_known(caplog):
    """As in a tunnel, or where `localise` was lost: a straight line there, told by nobody, bends a map."""
    poses = rows(*range(11), *range(41, 52))
    assert poses.at(20 * 10**8) is None
    assert poses.at(11 * 10**8 + 1) is None
    assert np.allclose(poses.at(11 * 10**8), turned(0, 11))
    assert np.allclose(poses.at(40 * 10**8), turned(0, 40))
    assert poses.at(40 * 10**8 - 1) is None
    assert np.allclose(poses.at(10 * 10**8 + 3), turned(0, 10), atol=1e-6)
    frame = scene(1)
    assert posed(frame.with_(stamp_ns=25 * 10**8), poses).pose is None
    (record,) = caplog.records
    assert "a hole, over which the sensor moved, from 1970-01-01T00:00:01.000 UTC to 1970-01-01T00:00:04" in (
        record.message
    )
    assert poses.starting(0).at(20 * 10**8) is None
    assert poses.seen_from(np.eye(4)).at(20 * 10**8) is None


def test_relative_poses_keep_their_holes():
    moments = [*range(11), *range(41, 52)]
    known = rows(*moments)
    relative = Poses(known.stamps_ns, np.stack([turned(0, at) for at in moments]), relative=True).starting(10**18)
    assert relative.at(10**18 + 20 * 10**8) is None
    assert relative.at(10**18 + 5 * 10**8) is not None


def test_a_sensor_that_stood_and_poses_that_are_far_apart_make_no_hole():
    moments = np.array([*range(11), *range(100, 111)])
    places = np.stack([turned(0, min(at, 10) + max(at - 100, 0)) for at in moments])
    assert np.allclose(Poses(moments * 10**8, places).at(50 * 10**8), turned(0, 10))
    assert rows(0, 20, 40, 110, 130).at(75 * 10**8) is not None
    assert rows(0, 1, 2, 3, 11, 12).at(7 * 10**8) is not None
