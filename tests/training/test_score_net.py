"""If these fail, the network of `poconet` cannot be trained again, or what ships is not what was trained."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="training needs torch: the extra `learned`")

from lidarcodec.api import read_frames  # noqa: E402
from lidarcodec.errors import SettingsError  # noqa: E402
from lidarcodec.reduction.score_image import score_image, unpatched  # noqa: E402
from lidarcodec.sources.simulator import SimulatorSource  # noqa: E402
from lidarcodec.training.annotation_folder import Labels  # noqa: E402
from lidarcodec.training.nets.score_net import ScoreNet, in_place  # noqa: E402
from lidarcodec.training.runs import seed_torch  # noqa: E402
from lidarcodec.training.score_data import Example, crop, example_of  # noqa: E402
from lidarcodec.training.score_metrics import Agreement  # noqa: E402
from lidarcodec.training.train_scores import ScoreRun, train_scores  # noqa: E402

pytestmark = pytest.mark.timeout(400)  # seconds of work, minutes on a machine that others use too
RUN = ScoreRun(seed=3, steps=12, batch=2, width=64, rate=5e-3)


@pytest.fixture(scope="module")
def example() -> Example:
    """Labels by rule: what stands out of the road is high, left of the car it is seldom seen."""
    with SimulatorSource("street", seed=6, frames=1) as source:
        frame = next(iter(read_frames(source)))
    high = np.zeros(frame.range.shape, np.uint8)
    high[frame.valid] = 3
    high[:24][frame.valid[:24]] = 2
    high[24:32][frame.valid[24:32]] = 1
    counts = np.where(high == 2, 20, 2).astype(np.uint16)
    return example_of(frame, Labels(counts, high, 10), np.random.default_rng(1))


@pytest.mark.sweep
def test_a_short_training_learns_and_goes_on_as_if_it_had_not_been_stopped(example: Example, tmp_path: Path) -> None:
    losses: list[float] = []
    whole = train_scores([example], tmp_path / "whole.pt", RUN, "cpu", tick=lambda step, loss: losses.append(loss))
    assert losses[-1] < 0.7 * losses[0]
    train_scores([example], tmp_path / "parts.pt", RUN, "cpu", seconds=0.0)
    parts = train_scores([example], tmp_path / "parts.pt", RUN, "cpu")
    for name, value in whole.state_dict().items():
        assert torch.equal(value, parts.state_dict()[name]), name


def test_a_run_is_not_resumed_with_another_drive(example: Example, tmp_path: Path) -> None:
    """The old network came out, and said that it was trained on the other one."""
    train_scores([example], tmp_path / "run.pt", RUN, "cpu", seconds=0.0)
    with pytest.raises(SettingsError, match="examples"):
        train_scores([example, example], tmp_path / "run.pt", RUN, "cpu")


def test_the_file_that_ships_computes_what_the_network_does(tmp_path: Path) -> None:
    onnxruntime = pytest.importorskip("onnxruntime", reason="the extra `poconet`")
    pytest.importorskip("onnx", reason="the extra `learned`")
    from lidarcodec.training.export_scores import export_scores

    seed_torch(5)
    net = ScoreNet().eval()
    export_scores(net, tmp_path / "net.onnx", {"trained_on": "nothing"})
    session = onnxruntime.InferenceSession(str(tmp_path / "net.onnx"), providers=["CPUExecutionProvider"])
    assert session.get_modelmeta().custom_metadata_map == {"trained_on": "nothing"}
    for columns in (16, 208, 2048):
        features = np.random.default_rng(columns).normal(size=(1, 6, 64, columns)).astype(np.float32)
        with torch.no_grad():
            expected = in_place(net(torch.from_numpy(features)))[0].numpy()
        found = unpatched(session.run(None, {"features": features})[0][0])
        np.testing.assert_allclose(found, expected, atol=1e-4)


def test_a_mirrored_crop_is_what_the_mirrored_street_would_look_like(example: Example) -> None:
    for seed in range(12):
        piece = crop(example, 128, np.random.default_rng(seed))
        assert piece.features.shape == (6, 64, 128)
        far = np.expm1(2 * (piece.features[0] + 1))  # range, near enough to the horizontal distance for signs
        step = np.diff(far, axis=1)
        both = (piece.features[3][:, 1:] > 0) & (piece.features[3][:, :-1] > 0) & (np.abs(step) > 0.5)
        signs = np.sign(piece.features[4][:, :-1])[both] == np.sign(step)[both]
        assert signs.mean() > 0.98


def test_agreement_is_one_for_the_truth_and_chance_for_a_guess() -> None:
    rng = np.random.default_rng(1)
    labels = rng.choice([1, 2, 3], 20000, p=[0.4, 0.1, 0.5])
    perfect, guess = Agreement(), Agreement()
    perfect.add((labels == 2).astype(float), labels, labels, labels == 2, labels == 2)
    guess.add(rng.random(20000) - (labels == 3), rng.choice([1, 2, 3], 20000), labels)
    assert perfect.result()["precision"] == perfect.result()["accuracy"] == 1.0
    assert set(perfect.result()["iou"].values()) == {1.0}
    assert perfect.result()["rank_correlation"] == 1.0
    assert guess.result()["precision"] == pytest.approx(guess.result()["chance"], abs=0.03)
    assert Agreement().result()["precision"] is None


def test_the_image_of_a_frame_fits_the_network() -> None:
    with SimulatorSource("road", seed=2, frames=1) as source:
        frame = next(iter(read_frames(source)))
    image = score_image(frame)
    with torch.no_grad():
        assert in_place(ScoreNet().eval()(torch.from_numpy(image.features)[None])).shape == (1, 5, 64, 2048)
