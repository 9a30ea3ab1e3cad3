"""Trans mATE, Rot mAPE and mAPE: against trajectories made by hand, and against the tool they are named after. If they
were off, no figure of ours could stand beside the paper's."""

import math

import numpy as np
import pytest

from lidarcodec.evaluation.localisation.errors import error_over_drives, pose_errors, standard_error, summary
from lidarcodec.evaluation.localisation.reference import pose_of


def some_poses(count, seed=3):
    random = np.random.default_rng(seed)
    return np.array([pose_of(random.normal(0, 0.8, 3), random.normal(0, 30, 3)) for _ in range(count)])


def test_a_step_aside_is_a_translation_and_nothing_else():
    reference = some_poses(4)
    estimate = reference.copy()
    estimate[:, :3, 3] += np.array([[0.3, 0, 0], [0, 0.4, 0], [0, 0, 0.5], [0.3, 0.4, 0]])
    found = pose_errors(estimate, reference)
    assert found["trans_m"] == pytest.approx([0.3, 0.4, 0.5, 0.5])
    assert found["ape"] == pytest.approx([0.3, 0.4, 0.5, 0.5])
    assert found["rot"] == pytest.approx(np.zeros(4), abs=1e-9)
    assert found["angle_deg"] == pytest.approx(np.zeros(4), abs=1e-6)


@pytest.mark.parametrize("degrees", [0.01, 1.0, 90.0, 179.0])
def test_a_turn_on_the_spot_is_a_rotation_and_nothing_else(degrees):
    reference = some_poses(1)
    turn = pose_of(np.radians(degrees) * np.array([0.6, 0.0, 0.8]), np.zeros(3))
    found = pose_errors(reference @ turn, reference)
    assert found["trans_m"] == pytest.approx([0.0], abs=1e-9)
    assert found["angle_deg"] == pytest.approx([degrees], rel=1e-6)
    # |R - I| as a Frobenius norm: 2 sqrt(2) sin(angle / 2), written out for the turn about one axis
    assert found["rot"] == pytest.approx([2 * math.sqrt(2) * math.sin(math.radians(degrees) / 2)], rel=1e-6)
    assert found["ape"] == pytest.approx(found["rot"], rel=1e-9)


def test_both_together_are_the_root_of_their_squares():
    reference = some_poses(5)
    estimate = reference @ some_poses(5, seed=4)
    found = pose_errors(estimate, reference)
    assert found["ape"] == pytest.approx(np.hypot(found["trans_m"], found["rot"]))
    slow = [np.linalg.norm(np.linalg.inv(r) @ e - np.eye(4)) for e, r in zip(estimate, reference, strict=True)]
    assert found["ape"] == pytest.approx(slow)


def test_evo_finds_the_same():
    metrics = pytest.importorskip("evo.core.metrics", reason="evo is not installed")
    from evo.core.trajectory import PosePath3D

    reference, estimate = some_poses(20), some_poses(20) @ some_poses(20, seed=9)
    found = pose_errors(estimate, reference)
    kinds = {
        "trans_m": metrics.PoseRelation.translation_part,
        "rot": metrics.PoseRelation.rotation_part,
        "ape": metrics.PoseRelation.full_transformation,
        "angle_deg": metrics.PoseRelation.rotation_angle_deg,
    }
    for field, kind in kinds.items():
        theirs = metrics.APE(kind)
        theirs.process_data((PosePath3D(poses_se3=list(reference)), PosePath3D(poses_se3=list(estimate))))
        assert found[field] == pytest.approx(theirs.error, rel=1e-9), field


def test_what_went_wrong_is_not_in_the_means():
    reference = some_poses(3)
    estimate = reference.copy()
    estimate[:, 0, 3] += [0.01, 0.03, 7.0]
    errors = pose_errors(estimate, reference)
    found = summary(errors, errors["trans_m"] < 0.5, seed=1)
    assert found["mate_m"] == pytest.approx(0.02)
    assert summary(errors, errors["trans_m"] > 8, seed=1)["mate_m"] is None


def test_the_bootstrap_says_what_theory_says_of_independent_errors():
    values = np.random.default_rng(5).normal(3.0, 0.4, 200)
    assert standard_error(values, seed=1) == pytest.approx(values.std() / math.sqrt(200), rel=0.1)
    assert standard_error(values, seed=1) == standard_error(values, seed=1)
    assert standard_error(values[:1], seed=1) is None


def test_drives_that_differ_make_the_error_over_drives_larger_than_that_over_frames():
    random = np.random.default_rng(6)
    drives = [random.normal(mean, 0.1, 50) for mean in (1.0, 2.0, 3.0, 4.0)]
    over = error_over_drives(drives, seed=1)
    assert over == pytest.approx(np.std([1, 2, 3, 4]) / 2, rel=0.15)
    assert over > 10 * standard_error(drives[0], seed=1)
    assert error_over_drives(drives[:1], seed=1) is None
