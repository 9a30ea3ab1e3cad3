"""What is kept of a map: numbers, bytes, the gap of the programme, and points where they are needed."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from lidarcodec.errors import SettingsError, UnknownNameError
from lidarcodec.maps.compress import bare, compressed, file_bytes, fitted
from lidarcodec.maps.points import MapPoints
from lidarcodec.maps.select.greedy import allotted
from lidarcodec.maps.select.table import METHODS
from tests.maps.towns import street
from tests.sweeps import sampled

TOWN = street()


@pytest.mark.parametrize("by", sampled(METHODS, [one for one in METHODS if one != "paper"]))
def test_no_method_keeps_more_than_it_may_and_all_keep_normals(by):
    if by in ("paper", "lp"):
        pytest.importorskip("highspy", reason="needs the extra `maps`")
    made, about = compressed(TOWN, by, 500)
    assert 0.9 * 500 <= len(made) <= 500
    assert (about["by"], about["points"]) == (by, len(made))
    assert set(made.columns) == {"normal_a", "normal_b"}
    assert not len(made.path)
    again, _ = compressed(TOWN, by, 500)
    assert np.array_equal(made.steps, again.steps)
    if by != "voxel":
        assert {*map(tuple, made.steps.tolist())} <= {*map(tuple, TOWN.steps.tolist())}


@pytest.mark.sweep
def test_bytes_are_kept_to_and_nearly_used():
    for by in ("greedy", "voxel", "random"):
        made, _ = fitted(TOWN, by, 4000)
        assert 3800 <= file_bytes(made) <= 4000


def test_maps_without_counts_or_of_too_few_points_are_refused():
    with pytest.raises(SettingsError, match="map build"):
        compressed(bare(TOWN), "greedy", 500)
    with pytest.raises(SettingsError, match="too small"):
        compressed(TOWN, "greedy", 20)
    with pytest.raises(SettingsError, match="fits into 150 bytes"):
        fitted(TOWN, "random", 150)
    with pytest.raises(UnknownNameError, match="lerned"):
        compressed(TOWN, "lerned", 500)
    wrong = replace(TOWN, path=TOWN.path[:3])
    with pytest.raises(SettingsError, match="places that are not on its path"):
        compressed(wrong, "greedy", 500)


def test_the_programme_is_solved_to_its_bound_and_rounded_well():
    pytest.importorskip("highspy", reason="needs the extra `maps`")
    town = street(length_m=20.0)
    for count in (300, len(town) - 1):  # the last ones are not worth the price that the first ones are
        made, about = compressed(town, "paper", count)
        assert len(made) == count
        assert about["gap"] < 0.01
        assert about["lambda"] >= 0.1


def test_the_programme_in_sections_states_a_gap_that_is_one():
    """Twelve points and three places: the bound lies below the best of all choices, found by trying them."""
    pytest.importorskip("highspy", reason="needs the extra `maps`")
    from lidarcodec.maps.select import programme

    random = np.random.default_rng(6)
    first = random.integers(0, 3, 12)
    last = np.minimum(first + random.integers(0, 2, 12), 2)
    columns = {"count": random.integers(1, 100, 12), "first": first, "last": last}
    points = MapPoints(
        0.02, np.arange(36).reshape(12, 3), {name: values.astype(np.uint16) for name, values in columns.items()},
        np.zeros((3, 3), np.float32),
    )  # fmt: skip
    groups = programme._groups(points)
    cost = groups.cost[groups.of]
    sees = np.stack([(first <= place) & (place <= last) for place in range(3)])
    for b in (1.0, 2.5, 4.0):
        solved = programme._solved(groups, 3, b, 0.5)
        value = (1 + programme._gap(groups, solved.taken, 3, solved, 0.5)) * solved.bound
        best = min(
            cost @ chosen + 0.5 * np.maximum(b - sees @ chosen, 0).sum()
            for chosen in map(np.array, itertools.product((0, 1), repeat=12))
        )
        assert solved.bound <= best + 1e-9
        assert best - 1e-9 <= value <= best * 1.2 + 0.5


def test_greedy_allots_as_if_it_took_the_largest_gain_each_time():
    """Against that choice made slowly: the gain of one more point of a group is w / (n + 1/2)."""
    random = np.random.default_rng(7)
    weights, size = random.uniform(1, 40, 30), random.integers(1, 40, 30)
    taken = np.zeros(30, np.int64)
    for _ in range(200):
        taken[np.argmax(np.where(taken < size, weights / (taken + 0.5), -1.0))] += 1
    found = allotted(weights, size, 200)
    assert found.sum() == 200
    assert (found <= size).all()
    assert np.abs(found - taken).max() <= 1
    assert allotted(weights, size, int(size.sum())).tolist() == size.tolist()


@pytest.mark.parametrize("by", ["greedy", "information"])
def test_points_along_the_whole_path_are_kept_and_the_few_that_face_along_it(by):
    """Thirty points face along the street, among ten thousand that do not."""
    along = np.array([[x * 100, 200, 100 + z] for x in range(10) for z in range(0, 30, 10)])
    values = {"normal_a": 31, "normal_b": 31, "count": 50, "first": 0, "last": 59}
    town = replace(
        TOWN,
        steps=np.concatenate([TOWN.steps, along]),
        columns={
            name: np.append(column, np.full(len(along), values[name], np.uint16))
            for name, column in TOWN.columns.items()
        },
    )
    made, _ = compressed(town, by, 600)
    by_lot, _ = compressed(town, "random", 600)
    facing = [np.count_nonzero(made.normals[:, 0] > 0.9) for made in (made, by_lot)]
    assert facing[0] > max(3 * facing[1], 8)
    assert np.histogram(made.steps[:, 0] * 0.02, bins=10, range=(0, 60))[0].min() > 20


def test_information_keeps_points_of_a_wall_before_those_of_a_hedge_that_as_many_scans_hit():
    """A localiser measures distances to planes, so that points of a hedge lead it astray."""
    steps = TOWN.steps.copy()
    right = steps[:, 1] > 290
    steps[right, 1] += np.random.default_rng(3).integers(-25, 26, np.count_nonzero(right))
    made, _ = compressed(replace(TOWN, steps=steps), "information", 600)
    assert np.count_nonzero(made.steps[:, 1] > 270) < 0.5 * np.count_nonzero(made.steps[:, 1] < -290)


def test_information_keeps_what_most_scans_hit_and_the_flattest_of_what_faces_along_the_path():
    """A scan that starts metres behind is held back by flat points beside it; flat ones across the path pull it on."""
    hits = {tuple(step): count for step, count in zip(TOWN.steps.tolist(), TOWN.columns["count"].tolist(), strict=True)}
    made, _ = compressed(TOWN, "information", 600)
    assert np.mean([hits[tuple(step)] for step in made.steps.tolist()]) > 100

    random = np.random.default_rng(4)
    board = np.stack([np.full(400, 1550), random.integers(0, 100, 400), random.integers(100, 200, 400)], axis=1)
    rough = board[:, 1] > 50
    board[rough, 0] += random.integers(-25, 25, np.count_nonzero(rough))
    columns = {"normal_a": 31, "normal_b": 31, "count": np.where(rough, 30, 20), "first": 10, "last": 50}
    town = replace(
        TOWN,
        steps=np.concatenate([TOWN.steps, board]),
        columns={
            name: np.append(column, np.broadcast_to(columns[name], 400).astype(np.uint16))
            for name, column in TOWN.columns.items()
        },
    )
    made, _ = compressed(town, "information", 600)
    kept = made.steps[made.normals[:, 0] > 0.9]
    assert len(kept) > 10
    assert np.mean(kept[:, 0] == 1550) > 0.9


def test_information_needs_normals():
    with pytest.raises(SettingsError, match="normals"):
        compressed(TOWN.with_columns("count", "first", "last"), "information", 500)
