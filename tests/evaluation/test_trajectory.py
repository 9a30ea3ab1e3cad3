"""If these fail, counts and errors of localisation are measured against poses that are wrong by more than they are."""

from pathlib import Path

import numpy as np
import pytest

from lidarcodec.api import read_frames
from lidarcodec.errors import SourceError, UnknownNameError
from lidarcodec.evaluation.rigid import exp_so3, invert, log_so3, moved
from lidarcodec.evaluation.trajectory import (
    Scan,
    Trajectory,
    deskewed,
    disagreement,
    map_of,
    odometry,
    refine,
    scan_of,
    voxel_means,
)
from lidarcodec.sources.poses import read_poses
from lidarcodec.sources.simulator import SimulatorSource


@pytest.fixture(scope="module")
def drive() -> tuple[list[Scan], Trajectory]:
    with SimulatorSource("street", seed=3, frames=12, traffic=0.0) as source:
        scans = [scan_of(frame) for frame in read_frames(source)]
        return scans, Trajectory.from_poses(source.poses, [scan.stamp_ns for scan in scans])


@pytest.fixture(scope="module")
def chained(drive: tuple[list[Scan], Trajectory]) -> Trajectory:
    return odometry(drive[0], "small_gicp")


def _errors_m(found: Trajectory, truth: Trajectory, gap: int = 8) -> np.ndarray:
    ways = [invert(each.matrices[:-gap]) @ each.matrices[gap:] for each in (found, truth)]
    return np.linalg.norm(ways[0][:, :3, 3] - ways[1][:, :3, 3], axis=1)


@pytest.mark.sweep
def test_odometry_and_refinement_find_a_drive_that_begins_at_speed(
    drive: tuple[list[Scan], Trajectory], chained: Trajectory
) -> None:
    scans, truth = drive
    assert np.linalg.norm(truth.velocities[0, :3]) > 3.0, "the drive must move, or it shows nothing"
    assert np.allclose(chained.matrices[0], np.eye(4))
    assert _errors_m(chained, truth).max() < 0.06
    refined = refine(scans, chained)
    assert _errors_m(refined, truth).max() < 0.03
    assert np.abs(refined.velocities[1:-1, :3] - truth.velocities[1:-1, :3]).max() < 0.15


def test_deskewing_the_wrong_way_is_worse_than_none_and_that_worse_than_the_right_way(
    drive: tuple[list[Scan], Trajectory],
) -> None:
    scans, truth = drive

    def spread(sign: float) -> int:
        turned = Trajectory(truth.stamps_ns, truth.matrices, sign * truth.velocities)
        pair = [turned.matrices[k] for k in (0, 11)], [deskewed(scans[k], turned.velocities[k]) for k in (0, 11)]
        return len(voxel_means(np.concatenate([moved(T, p) for T, p in zip(*pair, strict=True)]), 0.1))

    right, none, wrong = spread(1.0), spread(0.0), spread(-1.0)
    assert right < none < wrong


def test_disagreement_tells_a_good_trajectory_from_one_that_slides(drive: tuple[list[Scan], Trajectory]) -> None:
    scans, truth = drive
    slid = truth.matrices.copy()
    slid[:, 1, 3] += np.linspace(0.0, 0.15 * 11 / 8, 12)
    sliding = Trajectory.from_matrices(truth.stamps_ns, slid)
    good, bad = (np.abs(disagreement(scans, each, step=3)).max(axis=0) for each in (truth, sliding))
    assert len(disagreement(scans, truth, step=3)) == 2
    assert good[:2].max() < 0.03
    assert bad[:2].max() > 0.1


def test_what_moves_is_left_out_of_a_map_of_what_was_seen_twice(drive: tuple[list[Scan], Trajectory]) -> None:
    scans, truth = drive
    all_of_it, twice = (map_of(scans, truth, every=3, least_seen=least) for least in (1, 2))
    assert 1000 < len(twice) < len(all_of_it)


def test_a_trajectory_is_kept_and_serves_as_poses_of_every_command(
    drive: tuple[list[Scan], Trajectory], tmp_path: Path
) -> None:
    truth = drive[1]
    truth.save(tmp_path / "trajectory.npz")
    again = Trajectory.load(tmp_path / "trajectory.npz")
    assert np.array_equal(again.matrices, truth.matrices)
    assert np.array_equal(again.velocities, truth.velocities)
    found = read_poses(tmp_path / "trajectory.npz").at(int(truth.stamps_ns[4]))
    assert found is not None
    assert np.allclose(found, truth.matrices[4], atol=1e-4)


def test_input_that_cannot_be_registered_is_refused(drive: tuple[list[Scan], Trajectory], tmp_path: Path) -> None:
    scans, truth = drive
    with pytest.raises(UnknownNameError):
        odometry(scans, "compass")
    with pytest.raises(SourceError):
        odometry([])
    with pytest.raises(SourceError):
        refine(scans[:3], truth)
    empty = Scan(0, np.empty((0, 3), np.float32), np.empty(0, np.float32))
    with pytest.raises(SourceError):
        refine([empty], Trajectory.from_matrices([0], np.eye(4)[None]))
    (tmp_path / "other.npz").write_bytes(b"PK no trajectory")
    with pytest.raises(SourceError):
        Trajectory.load(tmp_path / "other.npz")


def test_scans_without_returns_keep_the_place_that_the_motion_leads_to() -> None:
    empty = [Scan(k * 100_000_000, np.empty((0, 3), np.float32), np.empty(0, np.float32)) for k in range(3)]
    found = odometry(empty, "small_gicp")
    assert np.array_equal(found.matrices, np.stack([np.eye(4)] * 3))
    assert np.array_equal(found.velocities, np.zeros((3, 6)))


def test_rotation_vectors_and_rotations_go_back_and_forth() -> None:
    vectors = np.random.default_rng(1).normal(size=(50, 3)) * 0.9
    there = np.stack([exp_so3(vector) for vector in vectors])
    assert np.allclose(log_so3(there), vectors)
