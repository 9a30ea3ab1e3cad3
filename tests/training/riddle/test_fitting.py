"""If these fail, training learns nothing, forgets what it learned when stopped, or exports something else."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from lidarcodec.errors import SettingsError
from lidarcodec.network.networks import Net

torch = pytest.importorskip("torch", reason="training needs torch: the extra `learned`")

from lidarcodec.training.riddle import nets  # noqa: E402
from lidarcodec.training.riddle.extraction import Rows, row_bytes  # noqa: E402
from lidarcodec.training.riddle.fitting import FitSettings, Measured, fit  # noqa: E402
from tests.sweeps import sampled  # noqa: E402

CPU = torch.device("cpu")
TOY = FitSettings(False, (16, 8), steps=300, batch=256, rate=1e-2, seed=3)


def toy_rows(count: int, seed: int, expects: bool = False) -> Rows:
    """Samples whose leaf follows two of their inputs, with some noise, and whose offset bit follows a third."""
    rng = np.random.default_rng(seed)
    rows = rng.integers(-60, 61, (count, row_bytes(expects))).astype(np.int8)
    rows[:, -18] = ((rows[:, 3].astype(int) + rows[:, 9] + rng.integers(-10, 11, count)) // 9 + 8).clip(0, 15)
    rows[:, -17] = np.where(rows[:, 5] > 30, -1, rows[:, 7] > 0)
    rows[:, -16:-14] = -1
    rows[:, -14:] = 0
    return rows


def nothing(_: Measured) -> None:
    """Watches nothing."""


@pytest.mark.sweep
def test_training_beats_the_network_it_began_with_on_samples_it_never_saw(tmp_path: Path) -> None:
    held = [toy_rows(3000, 2)]
    seen: list[Measured] = []
    net, state = fit(TOY, [toy_rows(8000, 1)], held, tmp_path / "a.pt", device=CPU, watch=seen.append, every=150)
    untrained = nets.RiddleNet(False, TOY.dims)
    assert nets.mean_bits(net, held) < 0.8 * nets.mean_bits(untrained, held)
    assert [measured.step for measured in seen] == [150, 300]
    assert seen[1].held_bits < seen[0].held_bits
    assert state.step == 300


@pytest.mark.parametrize(
    ("precision", "stop_at"), sampled(product(["float32", "mixed"], [27, 40, 45]), [("mixed", 40)])
)
def test_a_run_that_was_stopped_makes_the_weights_of_one_that_was_not(
    tmp_path: Path, precision: str, stop_at: int
) -> None:
    rows, held = [toy_rows(900, 1), toy_rows(50, 4), toy_rows(2000, 5)], [toy_rows(200, 2)]
    settings = FitSettings(False, (16, 8), steps=50, batch=128, seed=3, precision=precision)
    whole, _ = fit(settings, rows, held, tmp_path / "whole.pt", device=CPU, watch=nothing, every=20)
    fit(settings, rows, held, tmp_path / "cut.pt", device=CPU, watch=nothing, every=1, stop_at=stop_at)
    resumed, state = fit(settings, rows, held, tmp_path / "cut.pt", device=CPU, watch=nothing, every=20)
    assert state.log[-1]["step"] == 50
    for name, value in whole.state_dict().items():
        assert torch.equal(value, resumed.state_dict()[name]), name


def test_another_run_is_not_gone_on_with(tmp_path: Path) -> None:
    rows = [toy_rows(100, 1)]
    first = FitSettings(False, (8, 8), steps=2, batch=8)
    fit(first, rows, rows, tmp_path / "a.pt", device=CPU, watch=nothing)
    with pytest.raises(SettingsError, match="hidden"):
        fit(FitSettings(False, (16, 8), steps=2, batch=8), rows, rows, tmp_path / "a.pt", device=CPU, watch=nothing)


@pytest.mark.parametrize("expects", [False, True])
def test_whole_numbers_cost_what_floats_cost(tmp_path: Path, expects: bool) -> None:
    settings = FitSettings(expects, (16, 8), steps=40, batch=256, rate=1e-2)
    rows = [toy_rows(3000, 1, expects)]
    net, _ = fit(settings, rows, rows, tmp_path / "a.pt", device=CPU, watch=nothing)
    whole, bits = nets.exported(net, 0, rows)
    assert abs(bits - nets.mean_bits(net, rows)) < nets.WORST
    assert whole.inputs == (112 if expects else 72)
    assert bits == nets.mean_bits_whole(whole, rows)


def test_a_network_that_whole_numbers_would_change_is_not_exported(tmp_path: Path) -> None:
    """Weights a thousand times too fine for their layer vanish when they are rounded."""
    torch.manual_seed(1)
    net = nets.RiddleNet(False, (72, 8, 8, 32))
    with torch.no_grad():
        net.layers[0].weight *= 1e-5
        net.layers[0].weight[0, 0] = 200.0
        net.layers[1].weight *= 1e3
    with pytest.raises(SettingsError, match="the integer network"):
        nets.exported(net, 0, [toy_rows(2000, 1)])


def test_the_loss_is_that_of_the_tree(tmp_path: Path) -> None:
    """Log odds that say one leaf with certainty cost nothing there, and anywhere else what the coder's smallest
    probability does. Those of its first offset bit count half for the second and a quarter for the third."""
    odds = torch.zeros(1, 32)
    node = 1
    for bit in (1, 0, 1, 1):  # leaf 11
        odds[0, node] = 20.0 if bit else -20.0
        node = 2 * node + bit
    odds[0, 16 + 11] = -20.0  # first offset bit 0
    rows = np.zeros((4, row_bytes(False)), np.int8)
    rows[:, -18:-14] = [[11, 0, -1, -1], [11, 1, -1, -1], [10, -1, -1, -1], [11, 0, 1, 1]]
    odds, values = odds.repeat(4, 1), torch.from_numpy(rows)
    least, of_five = -math.log(0.5 * 0.085**3), -math.log(0.5 * (1 - 5 / 6) ** 3)
    costs = nets.RiddleLoss(CPU, smooth=0.0)(odds, values)
    assert costs.tolist() == pytest.approx([0.0, least, least, least + of_five], abs=0.01)
    smooth = nets.RiddleLoss(CPU, smooth=1.0)(odds, values)  # what is left of a slope beyond that
    assert smooth.tolist() == pytest.approx([0.0, 20.0, 20.0, 15.0], abs=0.01)


def test_the_last_steps_are_taken_in_eight_bits(tmp_path: Path) -> None:
    """A network that was rounded only afterwards would cost more than it said, or twice the time."""
    net, _ = fit(TOY, [toy_rows(5000, 1)], [toy_rows(2000, 2)], tmp_path / "c.pt", device=CPU, watch=nothing)
    whole, _ = nets.exported(net, 0, [toy_rows(2000, 2)])
    assert net.whole
    assert [layer.in_bytes for layer in whole.layers] == [True, False, False]


@pytest.mark.sweep
def test_training_begins_with_the_weights_that_it_is_given(tmp_path: Path) -> None:
    def begun(number: int, begin: Net | None) -> float:
        """Bits of the first batches."""
        found: list[float] = []
        fit(replace(TOY, steps=2), [toy_rows(5000, 1)], [toy_rows(2000, 2)], tmp_path / f"{number}.pt", device=CPU,
            watch=lambda at: found.append(at.trained_bits), begin=begin)  # fmt: skip
        return found[0]

    net, _ = fit(TOY, [toy_rows(5000, 1)], [toy_rows(2000, 2)], tmp_path / "c.pt", device=CPU, watch=nothing)
    assert begun(1, net.quantised(0)) < begun(2, None) - 0.1


@pytest.mark.parametrize("wrong", [{"steps": 0}, {"batch": 0}, {"rate": 0.0}, {"precision": "half"}])
def test_settings_out_of_range_are_named(wrong: dict[str, int]) -> None:
    with pytest.raises(SettingsError, match=next(iter(wrong))):
        FitSettings(False, **wrong)  # type: ignore[arg-type]
