"""If these fail, the largest network takes as long as one with all its weights, or has lost what it knew with them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lidarcodec.errors import SettingsError
from lidarcodec.network.tiles import tiles_left
from tests.sweeps import sampled

torch = pytest.importorskip("torch", reason="training needs torch: the extra `learned`")

from lidarcodec.training.riddle import nets, tiles  # noqa: E402
from lidarcodec.training.riddle.fitting import FitSettings, fit  # noqa: E402
from tests.training.riddle.test_fitting import CPU, nothing, toy_rows  # noqa: E402

TOY = FitSettings(False, (32, 16), keep=(0.25, 0.5), steps=400, batch=256, rate=1e-2, seed=3)


@pytest.mark.sweep
def test_what_is_left_is_as_much_as_was_asked_for_and_knows_as_much(tmp_path: Path) -> None:
    rows, held = [toy_rows(8000, 1)], [toy_rows(3000, 2)]
    few, _ = fit(TOY, rows, held, tmp_path / "few.pt", device=CPU, watch=nothing)
    every, _ = fit(replace(TOY, keep=(1.0, 1.0)), rows, held, tmp_path / "all.pt", device=CPU, watch=nothing)
    assert tiles.share_left(few.quantised(2)) == [0.25, 0.5]
    assert tiles.share_left(every.quantised(2)) == [1.0, 1.0]
    assert nets.mean_bits(few, held) < nets.mean_bits(every, held) + 0.05


@pytest.mark.parametrize("steps", sampled([8, 63, 64, 125, 126], [8, 64]))
def test_runs_of_every_length_leave_out_what_they_shall(tmp_path: Path, steps: int) -> None:
    rows = [toy_rows(400, 1)]
    net, _ = fit(replace(TOY, steps=steps, batch=32), rows, rows, tmp_path / "a.pt", device=CPU, watch=nothing)
    assert tiles.share_left(net.quantised(2)) == [0.25, 0.5]


@pytest.mark.sweep
def test_inputs_that_say_nothing_go_first(tmp_path: Path) -> None:
    """Tiles that are worth nothing are as good as each other, and there may be more of them than are to be left."""
    rows = [toy_rows(4000, 1)]
    rows[0][:, 16:72] = 0
    net, _ = fit(TOY, rows, rows, tmp_path / "a.pt", device=CPU, watch=nothing)
    first = tiles_left(net.quantised(2).layers[0].weights)
    assert first.mean() == 0.25
    assert first[:, :4].mean() > 0.9


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> nets.RiddleNet:
    rows, held = [toy_rows(2000, 1)], [toy_rows(200, 2)]
    return fit(TOY, rows, held, tmp_path_factory.mktemp("whole") / "whole.pt", device=CPU, watch=nothing)[0]


@pytest.mark.sweep
@pytest.mark.parametrize("stop_at", [49, 50, 130, 350])
def test_a_run_that_was_stopped_leaves_out_what_one_that_was_not_does(
    tmp_path: Path, stop_at: int, whole: nets.RiddleNet
) -> None:
    rows, held = [toy_rows(2000, 1)], [toy_rows(200, 2)]
    fit(TOY, rows, held, tmp_path / "cut.pt", device=CPU, watch=nothing, every=1, stop_at=stop_at)
    resumed, _ = fit(TOY, rows, held, tmp_path / "cut.pt", device=CPU, watch=nothing)
    for name, value in whole.state_dict().items():
        assert torch.equal(value, resumed.state_dict()[name]), name


@pytest.mark.sweep
def test_a_run_that_begins_with_few_tiles_keeps_them(tmp_path: Path) -> None:
    rows = [toy_rows(4000, 1)]
    toy = replace(TOY, keep=(0.3, 0.5))  # 11 of 36 tiles: a little more than three tenths
    begun = fit(toy, rows, rows, tmp_path / "a.pt", device=CPU, watch=nothing)[0].quantised(2)
    after = fit(toy, rows, rows, tmp_path / "b.pt", device=CPU, watch=nothing, begin=begun)[0].quantised(2)
    for before, now in zip(begun.layers, after.layers, strict=True):
        assert np.array_equal(tiles_left(before.weights), tiles_left(now.weights))
    assert not np.array_equal(begun.layers[0].weights, after.layers[0].weights)


def test_hidden_values_that_look_at_the_same_inputs_are_put_together() -> None:
    worth = np.zeros((64, 8))
    kind = np.random.default_rng(3).permutation(64) % 4
    worth[np.arange(64), kind] = worth[np.arange(64), kind + 4] = 1
    order = tiles.order_of(worth, keep=0.25)
    assert sorted(order) == list(range(64))
    assert [len(set(kind[order[at : at + 16]])) for at in range(0, 64, 16)] == [1, 1, 1, 1]


def test_layers_without_whole_tiles_are_refused() -> None:
    with pytest.raises(SettingsError, match="hidden"):
        FitSettings(False, (24, 16), keep=(0.5, 1.0))
    with pytest.raises(SettingsError, match="keep"):
        FitSettings(False, (32, 16), keep=(0.0, 1.0))
