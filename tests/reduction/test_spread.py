"""One return a cell: what a localiser gets has to be spread out, as dense as was asked for, and the same every time."""

from __future__ import annotations

import numpy as np
import pytest

from lidarcodec import _native, api, cloud
from lidarcodec.frame import Frame
from lidarcodec.reduction import best_of_cells, make_reducer
from lidarcodec.reduction.lots import drawn, exactly, lots
from lidarcodec.reduction.spread import LENGTHS_PER_M, Spread, lattice_of, returns_of
from lidarcodec.settings import StreamSettings


@pytest.fixture(scope="module")
def road() -> list[Frame]:
    return list(api.read_frames("sim:road?frames=3"))


def cells_of(frame: Frame, side_m: float, chosen: np.ndarray) -> np.ndarray:
    returns = returns_of(frame)
    points = returns.xyz[np.isin(returns.cells, chosen)] / LENGTHS_PER_M
    return np.floor(points / side_m).astype(int)


def test_points_lie_where_the_cloud_has_them(road: list[Frame]) -> None:
    returns = returns_of(road[0])
    x, y, z = (plane.T.ravel()[returns.cells] for plane in cloud.xyz_of(road[0]))
    assert np.array_equal(returns.cells, np.flatnonzero(road[0].valid))
    for axis, plane in enumerate((x, y, z)):
        assert np.abs(returns.xyz[:, axis] / LENGTHS_PER_M - plane).max() < 0.1


@pytest.mark.parametrize("count", [1, 100, 4500, 9000, 60_000])
def test_no_two_returns_of_a_cell_stay(road: list[Frame], count: int) -> None:
    spread = Spread()
    for frame in road:
        chosen = spread.choose(returns_of(frame), count, frame)
        assert len(np.unique(chosen)) == count
        cells = cells_of(frame, spread.side_m, chosen)
        assert len(np.unique(cells, axis=0)) > 0.995 * count  # floating point at borders of cells


def test_cells_as_large_as_the_budget_needs_and_no_larger(road: list[Frame]) -> None:
    spread = Spread()
    spread.choose(returns_of(road[0]), 9000, road[0])
    there_are = len(np.unique(cells_of(road[0], spread.side_m, returns_of(road[0]).cells), axis=0))
    assert 9450 <= there_are <= 1.021 * 9450  # one in twenty to spare


def test_far_returns_stay(road: list[Frame]) -> None:
    """They hold a localiser from afar; drawing by lot loses nine of ten of them."""
    frame = road[0]
    far = frame.valid & (frame.range > 30_000)
    kept = {
        name: make_reducer(StreamSettings(reduction=name, keep_points=9000)).reduce(frame).valid & far
        for name in ("voxel", "random")
    }
    assert kept["voxel"].sum() > 5 * kept["random"].sum()


def test_what_costs_little_to_send_is_taken_first(road: list[Frame]) -> None:
    """Most returns that stay lie on every eighth direction, where a lot would put an eighth of them."""
    frame = road[0]
    order, level = lattice_of(returns_of(frame), frame)
    assert np.array_equal(np.sort(order), np.arange(len(order)))
    assert (np.diff(level[order].astype(int)) >= 0).all()
    assert level.max() < 28
    rank = np.empty(len(order))
    rank[order] = np.linspace(0, 1, len(order))
    kept = np.searchsorted(returns_of(frame).cells, np.flatnonzero(
        make_reducer(StreamSettings(reduction="voxel", keep_points=9000)).reduce(frame).valid
    ))  # fmt: skip
    assert (rank[kept] < 0.125).mean() > 0.5


def test_of_cells_to_spare_those_go_that_cost_most(road: list[Frame]) -> None:
    """One cell in twenty too many: what is left out lies alone on its lattice, and which is a matter of luck."""
    frame = road[0]
    returns = returns_of(frame)
    level = lattice_of(returns, frame).level
    chosen = {seed: Spread(seed).choose(returns, 4500, frame) for seed in (1, 2)}
    assert all(len(np.unique(cells)) == 4500 for cells in chosen.values())
    one, two = (level[np.searchsorted(returns.cells, cells)] for cells in chosen.values())
    assert np.array_equal(np.sort(one), np.sort(two))
    differ = np.setxor1d(chosen[1], chosen[2])
    assert len(differ) > 20
    assert (level[np.searchsorted(returns.cells, differ)] == one.max()).all()


def test_best_scores_stay_and_no_two_in_a_small_cell(road: list[Frame]) -> None:
    frame = road[0]
    scores = np.random.default_rng(1).random(frame.range.shape)
    chosen = best_of_cells(frame, scores, 5000)
    assert len(np.unique(chosen)) == 5000
    mean = scores.ravel()[chosen].mean()
    assert mean > 0.9
    only_within = best_of_cells(frame, scores, 5000, over=1.0)
    assert 0.6 < scores.ravel()[only_within].mean() < mean
    plain = np.argsort(-np.where(frame.valid, scores, -1).ravel())[:5000]
    side = 0.2
    crowded = len(np.unique(cells_of(frame, side, plain), axis=0))
    assert len(np.unique(cells_of(frame, side, chosen), axis=0)) > 1.1 * crowded


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_ground_gets_its_share(road: list[Frame], share: float) -> None:
    frame = road[0]
    ground = np.arange(64)[:, None] * np.ones(frame.width) > 40
    scores = np.random.default_rng(2).random(frame.range.shape).astype(np.float32)
    chosen = best_of_cells(frame, scores, 4000, ground=ground, ground_share=share)
    assert len(np.unique(chosen)) == 4000
    assert ground.ravel()[chosen].sum() == pytest.approx(4000 * share)


def test_what_one_side_lacks_the_other_gets(road: list[Frame]) -> None:
    frame = road[0]
    ground = np.zeros(frame.range.shape, np.bool_)
    scores = np.zeros(frame.range.shape)
    assert len(best_of_cells(frame, scores, 4000, ground=ground, ground_share=0.5)) == 4000
    assert len(best_of_cells(frame, scores, 4000, ground=~ground, ground_share=0.5)) == 4000
    assert len(best_of_cells(frame, np.full_like(scores, np.nan), 10**6)) == frame.points


def test_equal_scores_are_decided_by_the_seed(road: list[Frame]) -> None:
    frame = road[0]
    same = np.zeros(frame.range.shape)
    chosen = [np.sort(best_of_cells(frame, same, 2000, seed=seed)) for seed in (1, 1, 2)]
    assert np.array_equal(chosen[0], chosen[1])
    assert len(np.intersect1d(chosen[0], chosen[2])) < 1000


def test_lots_are_fair_and_the_same_everywhere() -> None:
    cells = np.arange(100_000, dtype=np.uint32)
    some = drawn(cells, 10_000, 1, 5)
    assert len(np.unique(some)) == 10_000
    assert abs(some.mean() / 50_000 - 1) < 0.02
    assert abs(len(np.intersect1d(some, drawn(cells, 10_000, 1, 6))) / 1000 - 1) < 0.2
    assert lots(np.array([0, 1, 70_000], np.uint32), 1, 0).tolist() == EXPECTED_LOTS


def test_exactly_as_many_as_asked() -> None:
    chosen, others = np.array([5, 9, 2], np.uint32), np.arange(12, dtype=np.uint32)
    for count in range(1, 13):
        found = exactly(chosen, others, count, 1, 0)
        assert len(np.unique(found)) == len(found) == count
        assert np.isin(found, chosen).sum() == min(count, 3)


EXPECTED_LOTS = [9370218965779684112, 163099854727822514, 4106886573556880745]


def test_returns_that_are_all_at_one_spot_leave_a_side_to_begin_with() -> None:
    """No side gives two cells there: the search ends, and the next frame's begins at a side that can be."""
    xyz = np.full((500, 3), 40_000, np.int32)
    for begin in (32, 8_000, 16_000_000):
        places, side = _native.pick_cells(xyz, np.arange(500, dtype=np.uint32), 2, begin)
        assert len(places) == 1
        assert 32 <= side <= 16_000_000
