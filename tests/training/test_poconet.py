"""If these fail, what is called PocoNet here is not the network of the paper, or does not learn."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="training needs torch: the extra `learned`")

from lidarcodec.api import read_frames  # noqa: E402
from lidarcodec.errors import SettingsError, SourceError  # noqa: E402
from lidarcodec.sources.simulator import SimulatorSource  # noqa: E402
from lidarcodec.training.annotation_folder import AnnotationFolder, Labels  # noqa: E402
from lidarcodec.training.nets.poconet import CODEWORD, GlobalFeatureAttention, PocoNet, WeightedSum  # noqa: E402
from lidarcodec.training.poco_data import PAPER_POINTS, lent, levels_of, poco_returns, poco_scan  # noqa: E402
from lidarcodec.training.runs import load_checkpoint, save_checkpoint, seed_torch  # noqa: E402
from lidarcodec.training.train_poconet import (  # noqa: E402
    PocoRun,
    best_of,
    curve_of,
    measure_poconet,
    poconet_logits,
    train_poconet,
)
from tests.command_line import run_here  # noqa: E402

pytestmark = pytest.mark.timeout(400)  # seconds of work, minutes on a machine that others use too
POINTS = 512
CPU = torch.device("cpu")


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two frames with labels by rule: high is what is high up."""
    folder = AnnotationFolder(tmp_path_factory.mktemp("poconet") / "drive")
    with SimulatorSource("street", seed=8, frames=2) as source:
        for k, frame in enumerate(read_frames(source)):
            if k == 0:
                folder.begin({"source": "a street"}, frame.sensor)
            folder.write_frame(k, frame)
            label = np.where(np.arange(64)[:, None] < 20, 2, np.where(np.arange(64)[:, None] < 36, 1, 3))
            labels = (label * frame.valid).astype(np.uint8)
            folder.write_labels(k, Labels(labels.astype(np.uint16), labels, 1))
    folder.note(frames=2)
    return folder.path


@pytest.mark.sweep
def test_a_toy_training_learns_is_seeded_and_goes_on_where_it_was(drive: Path, tmp_path: Path) -> None:
    run = PocoRun(seed=4, epochs=3, points=POINTS, rate=3e-3)
    losses: list[float] = []
    whole = train_poconet([drive], tmp_path / "whole.pt", run, "cpu", tick=lambda step, loss, _: losses.append(loss))
    assert len(losses) == 6
    assert np.mean(losses[-2:]) < 0.9 * np.mean(losses[:2])
    train_poconet([drive], tmp_path / "parts.pt", run, "cpu", seconds=0.0)
    parts = train_poconet([drive], tmp_path / "parts.pt", run, "cpu")
    for name, value in whole.state_dict().items():
        assert torch.equal(value, parts.state_dict()[name]), name
    found = measure_poconet(whole, [drive], POINTS)
    assert found["frames"] == 2
    assert 0.0 <= found["precision"] <= 1.0
    json.dumps(found)


@pytest.mark.sweep
def test_a_training_by_the_clock_ends_in_time_with_a_curve_and_the_best_network(drive: Path, tmp_path: Path) -> None:
    """Without it nobody knows when a network was done, and a run on a busy machine ends at its highest rate."""
    out = tmp_path / "clock.pt"
    train_poconet([drive], out, PocoRun(seed=4, points=POINTS, minutes=60.0), "cpu", seconds=0.0)
    begun = load_checkpoint(out)
    assert begun is not None
    assert begun.step == 1
    run = PocoRun(seed=4, points=POINTS, minutes=begun.seconds / 60 + 0.02)
    train_poconet([drive], out, run, "cpu", validate=[drive], measure_seconds=0.5)
    state, best = load_checkpoint(out), load_checkpoint(best_of(out))
    assert state is not None
    assert best is not None
    assert state.step > 1
    assert state.seconds >= begun.seconds + 60 * 0.02
    with curve_of(out).open() as file:
        rows = list(csv.DictReader(file))
    assert [row["step"] for row in rows] == [str(entry["step"]) for entry in state.log]
    precision = {row["step"]: float(row["precision"]) for row in rows if row["drive"] == drive.name}
    assert precision[str(best.step)] == max(precision.values())
    assert all(float(row["processor_minutes"]) >= 0 for row in rows)
    with pytest.raises(SettingsError, match="minutes"):
        PocoRun(minutes=0.0)


@pytest.mark.sweep
def test_the_best_network_is_chosen_anew_where_other_drives_are_looked_at(drive: Path, tmp_path: Path) -> None:
    """Precision on an easier drive would stand for ever, and the network of that day would be the one that is kept."""
    out, run = tmp_path / "on.pt", PocoRun(seed=4, epochs=3, points=POINTS)
    train_poconet([drive], out, run, "cpu", seconds=0.0, validate=[drive], measure_seconds=0.0)
    state = load_checkpoint(out)
    assert state is not None
    measured: list[dict[str, Any]] = state.log[-1]["drives"]
    measured[0] |= {"drive": "easier", "precision": 1.0}
    save_checkpoint(out, state)
    train_poconet([drive], out, run, "cpu", seconds=0.0, validate=[drive], measure_seconds=0.0)
    best = load_checkpoint(best_of(out))
    assert best is not None
    assert best.step == 2


def test_the_weighted_sum_and_its_gradient_are_those_of_the_plain_formula() -> None:
    """Its gradient is written by hand, to train faster: a wrong one would train another network."""
    seed_torch(3)
    features, scores = (torch.randn(2, 3, 4, 5, dtype=torch.float64, requires_grad=True) for _ in range(2))
    plain = (features * torch.softmax(scores, dim=2)).sum(dim=2)
    assert torch.equal(WeightedSum.apply(features, scores), plain)
    assert torch.autograd.gradcheck(WeightedSum.apply, (features, scores))


def test_the_second_branch_has_the_codeword_of_the_whole_network(drive: Path) -> None:
    scan = poco_scan(poco_returns(AnnotationFolder(drive).frame(0), None), POINTS, np.random.default_rng(1))
    assert scan is not None
    seed_torch(2)
    net, inputs = PocoNet().eval(), levels_of([scan], np.random.default_rng(3), CPU)
    features = torch.from_numpy(scan.features.T[None])
    with torch.no_grad():
        assert torch.equal(net.codeword(features, *inputs[:3]), net(features, *inputs)[1])


def test_attention_weights_add_up_to_one_over_what_is_summed() -> None:
    """Equation 4 normalises beta_ij over i, so equation 5 must sum over i, whatever its indices say."""
    seed_torch(2)
    layer = GlobalFeatureAttention(32).eval()
    features = torch.randn(2, 32, 17)
    beta = layer.attention(features)
    assert torch.allclose(beta.sum(dim=1), torch.ones(2, 17), atol=1e-6)
    one = features.clone()
    one[:, :, 5] += 3.0  # what one point says reaches the codeword through all others
    assert layer(features).shape == (2, CODEWORD)
    assert not torch.allclose(layer(features), layer(one))


def test_the_codeword_does_not_depend_on_the_order_of_the_points() -> None:
    seed_torch(2)
    layer = GlobalFeatureAttention(32).eval()
    features = torch.randn(1, 32, 40)
    with torch.no_grad():
        assert torch.allclose(layer(features), layer(features[:, :, torch.randperm(40)]), atol=1e-5)


def test_a_scan_that_is_short_repeats_and_one_that_is_long_lends_its_labels(drive: Path) -> None:
    folder = AnnotationFolder(drive)
    frame, truth = folder.frame(0), folder.labels(0)
    returns = poco_returns(frame, truth)
    short = poco_scan(returns, frame.points + 1000, np.random.default_rng(1))
    few = poco_scan(returns, POINTS, np.random.default_rng(1))
    assert short is not None
    assert few is not None
    assert len(short.points) == frame.points + 1000
    assert len(np.unique(short.points, axis=0)) <= frame.points
    assert PAPER_POINTS == 122_880
    cloud = frame.cloud()
    own = np.stack([cloud[axis] for axis in "xyz"], axis=1)
    chosen = few.points[lent(few, returns)[:200]]
    closest = ((own[:200, None] - few.points[None]) ** 2).sum(axis=2).min(axis=1)
    assert np.allclose(((own[:200] - chosen) ** 2).sum(axis=1), closest, rtol=1e-4)
    empty = frame.with_(range=np.zeros_like(frame.range))
    assert poco_scan(poco_returns(empty, None), POINTS, np.random.default_rng(1)) is None
    assert poconet_logits(PocoNet().eval(), empty, POINTS, np.random.default_rng(1)).shape == (3, 0)


def test_two_draws_of_the_sampling_differ_and_both_keep_a_quarter(drive: Path) -> None:
    scan = poco_scan(poco_returns(AnnotationFolder(drive).frame(0), None), POINTS, np.random.default_rng(1))
    assert scan is not None
    rng = np.random.default_rng(3)
    one, two = levels_of([scan], rng, CPU), levels_of([scan], rng, CPU)
    assert [len(kept[0]) for kept in one.kept] == [128, 32, 8, 2]
    assert [tuple(near.shape[1:]) for near in one.near] == [(512, 12), (128, 12), (32, 12), (8, 8)]
    assert not torch.equal(one.kept[0], two.kept[0])
    assert torch.equal(one.points[1][0], one.points[0][0][:, one.kept[0][0]])


@pytest.mark.sweep
def test_wrong_settings_and_drives_without_labels_are_refused(drive: Path, tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="points"):
        PocoRun(points=100)
    with pytest.raises(SourceError):
        train_poconet([tmp_path], tmp_path / "run.pt", PocoRun(points=POINTS), "cpu")
    train_poconet([drive], tmp_path / "run.pt", PocoRun(points=POINTS, epochs=1), "cpu", seconds=0.0)
    with pytest.raises(SettingsError, match="points"):
        train_poconet([drive], tmp_path / "run.pt", PocoRun(points=1024, epochs=1), "cpu")


def test_the_commands_train_measure_and_write_the_file_of_the_reducers(drive: Path, tmp_path: Path) -> None:
    done = run_here("train", "poconet", str(drive), "--out", str(tmp_path / "poconet.pt"), "--epochs", "1",
                    "--points", "512", "--test", str(drive), "--json")  # fmt: skip
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["steps"] == 2
    assert told["tests"][str(drive)]["frames"] == 2
    pytest.importorskip("onnx", reason="the extra `learned`")
    done = run_here("train", "scores", str(drive), "--out", str(tmp_path / "scores.pt"), "--steps", "1",
                    "--onnx", str(tmp_path / "scores.onnx"), "--note", "a toy")  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "scores.onnx").stat().st_size < 1_000_000
    done = run_here("train", "scores", str(tmp_path), "--out", str(tmp_path / "new.pt"))
    assert done.returncode == 2
    assert "annotate" in done.stderr
