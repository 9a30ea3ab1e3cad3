"""If these fail, training teaches nothing, or a run that was stopped ends with other weights than one that was not."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from lidarcodec.errors import SettingsError, SourceError

torch = pytest.importorskip("torch", reason="training needs torch: the extra `learned`")

from lidarcodec.motion.motion import STILL  # noqa: E402
from lidarcodec.training import runs  # noqa: E402
from research.riddle_paper.coding import Predictor  # noqa: E402
from research.riddle_paper.data import PreparedScans, Scan, read_scans  # noqa: E402
from research.riddle_paper.images import image_of, previous_valid  # noqa: E402
from research.riddle_paper.net import NetShape, RiddlePaper  # noqa: E402
from research.riddle_paper.residuals import entropy_bits  # noqa: E402
from research.riddle_paper.run import BEST, CHECKPOINT, CURVE, Progress, RunSettings, load_net, train  # noqa: E402
from tests.research.riddle_paper.scenes import toy_frame, toy_ranges  # noqa: E402

SMALL = RunSettings(steps=12, batch=64, encoder=(8, 16), decoder=(16,), quanta=(10,))


def scans(count: int, first_seed: int = 20, columns: int = 150) -> list[Scan]:
    """Toy turns; each says that the one before it is itself, seen by a sensor that stands."""
    found = []
    for seed in range(first_seed, first_seed + count):
        frame = toy_frame((toy_ranges(seed, 64, columns).clip(0, 100) * 500).astype(np.uint16))
        found.append(Scan(frame, frame, STILL))
    return found


@pytest.mark.timeout(600)  # 5 s of a core; ten times that on a busy machine
@pytest.mark.sweep
def test_a_short_training_beats_the_previous_valid_return(tmp_path: Path) -> None:
    settings = RunSettings(steps=200, batch=128, frames=1, quanta=(10,), rate=5e-3, encoder=(16, 32, 64), decoder=(64,))
    net = train(scans(6), [], settings, tmp_path, every=1000)
    predictor = Predictor(net, torch.device("cpu"))
    image = image_of(scans(1, first_seed=50)[0].frame, 10)
    true = image.cells[image.valid].astype(np.int64)
    learned = true - predictor.predict_all(image)[image.valid]
    plain = true - previous_valid(image.cells, image.valid)[image.valid]
    assert entropy_bits(learned) < 0.92 * entropy_bits(plain)  # 0.85 when written
    assert np.median(np.abs(learned)) <= np.median(np.abs(plain))


@pytest.mark.sweep
@pytest.mark.parametrize("temporal", [0, 5])
def test_a_resumed_run_makes_the_weights_of_one_without_a_break(tmp_path: Path, temporal: int) -> None:
    settings = RunSettings(**{**SMALL.__dict__, "temporal": temporal})
    seen: list[Progress] = []
    whole = train(scans(3), scans(1, 60), settings, tmp_path / "whole", every=5, tell=seen.append)
    train(scans(3), scans(1, 60), settings, tmp_path / "parts", every=5, until=7)
    parts = train(scans(3), scans(1, 60), settings, tmp_path / "parts", every=5)
    for name, weights in whole.state_dict().items():
        assert torch.equal(weights, parts.state_dict()[name]), name
    assert [progress.step for progress in seen] == list(range(1, 13))
    kept, log = load_net(tmp_path / "parts")
    assert all(torch.equal(kept.state_dict()[name], weights) for name, weights in whole.state_dict().items())
    assert [entry["step"] for entry in log.log] == [5, 7, 10, 12]
    assert log.log[-1]["within_10_cm"] is not None


@pytest.mark.sweep
def test_a_run_may_be_made_shorter_on_the_way(tmp_path: Path) -> None:
    train(scans(2), [], SMALL, tmp_path, until=2)
    train(scans(2), [], RunSettings(**{**SMALL.__dict__, "steps": 3}), tmp_path)
    _, state = load_net(tmp_path)
    assert (state.step, state.settings["steps"]) == (3, 3)


@pytest.mark.sweep
def test_a_run_is_not_resumed_as_another(tmp_path: Path) -> None:
    train(scans(2), [], SMALL, tmp_path, until=2)
    with pytest.raises(SettingsError, match="seed"):
        train(scans(2), [], RunSettings(**{**SMALL.__dict__, "seed": 2}), tmp_path)


@pytest.mark.sweep
def test_seeds_make_different_runs_and_the_same_seed_the_same(tmp_path: Path) -> None:
    nets = [
        train(scans(2), [], RunSettings(**{**SMALL.__dict__, "seed": seed}), tmp_path / name, until=2)
        for name, seed in (("a", 1), ("b", 1), ("c", 2))
    ]
    a, b, c = (torch.cat([weights.flatten() for weights in net.state_dict().values()]) for net in nets)
    assert torch.equal(a, b)
    assert not torch.equal(a, c)


@pytest.mark.sweep
def test_a_training_by_the_clock_ends_in_time_with_a_curve_and_the_best_network(tmp_path: Path) -> None:
    long = RunSettings(**{**SMALL.__dict__, "steps": 1, "minutes": 60.0})
    other = {"other": scans(1, 70)}
    train(scans(2), scans(1, 60), long, tmp_path, validate=other, until=2)  # minutes count, not steps
    _, begun = load_net(tmp_path)
    assert begun.step == 2
    short = RunSettings(**{**SMALL.__dict__, "steps": 1, "minutes": begun.seconds / 60 + 0.005})
    train(scans(2), scans(1, 60), short, tmp_path, every_seconds=0.1, validate=other)
    _, state = load_net(tmp_path)
    assert state.step > 2
    assert state.seconds >= begun.seconds + 0.3
    _, best = load_net(tmp_path, file=BEST)
    assert best.log[-1]["held_out_bits"] == min(entry["held_out_bits"] for entry in state.log)
    with (tmp_path / CURVE).open() as file:
        rows = list(csv.DictReader(file))
    assert [(row["step"], row["step_m"]) for row in rows] == [
        (str(entry["step"]), step) for entry in state.log for step in ("0.022", "0.102")
    ]
    assert {row["drive"] for row in rows} == {"other"}
    with pytest.raises(SettingsError, match="minutes"):
        RunSettings(**{**SMALL.__dict__, "minutes": -1.0})


def test_images_that_stay_ready_give_what_new_ones_give() -> None:
    """Kept to train faster: a stale one would teach the ranges of another scan or step."""
    kept, quanta = PreparedScans(scans(3), 5, most=2), (10, 51)
    for step in range(8):
        new = PreparedScans(scans(3), 5, most=0)
        one, two = (some.batch(quanta, 60, 2, runs.step_rng(1, step)) for some in (kept, new))
        for a, b in zip(one, two, strict=True):
            assert a.step == b.step
            assert np.array_equal(a.ranges_m, b.ranges_m)
            assert np.array_equal(a.contexts.features, b.contexts.features)


def test_the_embedding_and_its_gradient_are_those_of_the_plain_maximum() -> None:
    """Only neighbours that reach a maximum are trained on, to train faster: leaving out others must change nothing."""
    runs.seed_torch(5)
    net = RiddlePaper(NetShape(spatial=9, features=7, encoder=(8, 16), decoder=(12,))).double()
    features = torch.randn(6, 9, 7, dtype=torch.float64)
    features[:, 5:] = features[:, 5:6]  # as neighbours that are not there: all alike
    wanted = torch.randn(6, 16, dtype=torch.float64)
    found = []
    for embedding in (net.encoder(features).amax(dim=1), net._embedding(features)):
        net.zero_grad()
        (embedding * wanted).sum().backward()
        found.append([embedding.detach(), *(weights.grad.clone() for weights in net.encoder.parameters())])
    for plain, quick in zip(*found, strict=True):
        assert torch.allclose(plain, quick, atol=1e-12)


def test_what_cannot_be_trained_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="nothing to train on"):
        train([Scan(scans(1)[0].frame)], [], RunSettings(**{**SMALL.__dict__, "temporal": 3}), tmp_path)
    for wrong in ({"batch": 0}, {"steps": 0}, {"quanta": ()}, {"quanta": (0,)}, {"temporal": -1}, {"batch": 1}):
        with pytest.raises(SettingsError):
            RunSettings(**{**SMALL.__dict__, **wrong})
    with pytest.raises(SourceError, match="train one first"):
        load_net(tmp_path / "nowhere")
    runs.save_checkpoint(tmp_path / CHECKPOINT, runs.Checkpoint(1, {"colour": "blue"}, {}, {}))
    with pytest.raises(SourceError, match="not one of RIDDLE"):
        load_net(tmp_path)


def test_turns_of_a_source_come_with_the_motion_between_them() -> None:
    found = read_scans("sim:city?seed=3&frames=3", every=1)
    assert len(found) >= 2
    assert found[0].motion is None
    assert all(scan.earlier is not None and scan.motion is not None for scan in found[1:])
