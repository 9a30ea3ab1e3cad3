"""If these fail, the figures of docs/riddle-paper.md mean something else than they say."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="training needs torch: the extra `learned`")

from lidarcodec.motion.motion import STILL  # noqa: E402
from lidarcodec.training import runs  # noqa: E402
from research.riddle_paper import __main__ as command  # noqa: E402
from research.riddle_paper.coding import Predictor  # noqa: E402
from research.riddle_paper.data import Scan  # noqa: E402
from research.riddle_paper.images import image_of, previous_valid  # noqa: E402
from research.riddle_paper.measure import Learned, comes_back, drawn_returns, ours, whole_frames  # noqa: E402
from research.riddle_paper.net import NetShape, RiddlePaper  # noqa: E402
from tests.research.riddle_paper.scenes import toy_frame, toy_ranges  # noqa: E402


def scan(seed: int = 30, columns: int = 40) -> Scan:
    frame = toy_frame((toy_ranges(seed, 64, columns).clip(0, 100) * 500).astype(np.uint16))
    return Scan(frame, frame, STILL)


def nets() -> dict[str, Learned]:
    runs.seed_torch(1)
    return {
        name: Learned(Predictor(RiddlePaper(NetShape(temporal=count)), torch.device("cpu")), count)
        for name, count in (("intra", 0), ("temporal", 5))
    }


@pytest.mark.sweep
def test_shares_and_bits_are_those_of_all_returns() -> None:
    one = scan()
    rows = whole_frames([one, one], {}, 51)
    image = image_of(one.frame, 51)
    left = (image.cells - previous_valid(image.cells, image.valid))[image.valid]
    row = rows["previous valid"]
    assert row["returns"] == 2 * len(left)
    assert row["right_cell"] == pytest.approx((left == 0).mean())
    assert row["within_0.1_m"] == pytest.approx((left == 0).mean())  # a step is 10.2 cm
    fine = whole_frames([one], {}, 10)["previous valid"]
    assert fine["right_cell"] < fine["within_0.1_m"]
    assert 0 < row["bits"]["entropy"] < fine["bits"]["entropy"]
    learned = whole_frames([one], nets(), 51)
    assert {row["returns"] for row in learned.values()} == {len(left)}
    everything = drawn_returns([one], {}, 51, count=10**6)["previous valid"]
    assert everything["right_cell"] == pytest.approx(row["right_cell"])


@pytest.mark.sweep
def test_a_scan_comes_back_within_half_a_step_by_each_predictor() -> None:
    for net in nets().values():
        found = comes_back(scan(columns=16), net, 11)
        assert found["largest_error_m"] <= 0.010 + 1e-9
        assert found["bits"] > 0


def test_ours_is_measured_beside_it_on_the_same_returns() -> None:
    found = ours([scan()], 11)
    assert set(found) == {"predictive", "predictive, scan before", "mask", "mask, scan before"}
    assert {row["returns"] for row in found.values()} == {scan().frame.points}
    assert found["predictive, scan before"]["bits"]["range"] < found["predictive"]["bits"]["range"]


@pytest.mark.sweep
@pytest.mark.timeout(600)
def test_the_command_trains_measures_and_prints(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def call(*words: str) -> int:
        monkeypatch.setattr(sys, "argv", ["riddle_paper", *words])
        return command.main()

    source, out, found = "sim:street?seed=2&frames=4", str(tmp_path / "run"), tmp_path / "found.json"
    small = ["--steps", "2", "--batch", "32", "--hold-out", "1"]
    assert call("train", source, "--out", out, *small, "--every", "1") == 0
    assert call("train", source, "--out", out, *small, "--seed", "5") == 1
    assert "seed" in capsys.readouterr().err
    measured = ["--steps", "51", "--skip", "1", "--frames", "1", "--drawn", "50", "--whole", "0", "--json", str(found)]
    assert call("evaluate", source, "--intra", out, *measured) == 0
    shown = capsys.readouterr().out
    assert "| RIDDLE intra |" in shown
    assert json.loads(found.read_text())["trained"]["intra"]["step"] == 2
    assert call("table", str(found)) == 0
    assert capsys.readouterr().out == shown
    assert call("evaluate", source, "--intra", str(tmp_path / "nowhere"), *measured) == 1
    assert "train one first" in capsys.readouterr().err
