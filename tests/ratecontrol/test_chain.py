"""A chain of working points: a higher target never gives a worse picture, in anything that is looked at."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarcodec.ratecontrol.chain import GAIN, MOST, NEAR, chain

POINT = st.tuples(st.integers(1, 12), st.integers(1, 12), st.integers(0, 3), st.integers(0, 3))


def area(bits: np.ndarray, cost: np.ndarray) -> float:
    """Under the cost, over the logarithm of the bits."""
    return float((cost[:-1] * np.diff(np.log(bits))).sum())


@given(st.lists(POINT, min_size=1, max_size=40))
@settings(deadline=None)
def test_each_point_of_a_chain_is_better_than_the_one_before_in_everything(points) -> None:
    bits, cost, *never_more = np.array(points, np.float64).T
    kept = chain(bits, cost, np.array(never_more))
    assert len(kept) >= 1
    assert cost[kept[-1]] == cost.min(), "with bits enough the picture is the best that there is"
    for before, after in pairwise(kept):
        assert bits[after] > bits[before]
        assert cost[after] <= (1 - GAIN) * cost[before]
        assert all(of[after] <= of[before] for of in never_more)


@given(st.lists(POINT, min_size=1, max_size=7))
@settings(deadline=None)
def test_no_other_chain_from_its_first_point_shows_more(points) -> None:
    bits, cost, *never_more = np.array(points, np.float64).T
    kept = chain(bits, cost, np.array(never_more))
    best = area(bits[kept], cost[kept])
    looked_at = [place for place in range(len(bits)) if cost[place] <= NEAR * cost[bits <= bits[place]].min()]

    def others(at: list[int]):
        if at[-1] == kept[-1]:
            yield at
        for place in looked_at:
            better = bits[place] > bits[at[-1]] and cost[place] < cost[at[-1]]
            if better and all(of[place] <= of[at[-1]] for of in never_more):
                yield from others([*at, place])

    for other in others([int(kept[0])]):
        assert area(bits[other], cost[other]) >= best - 1e-9


def test_many_points_are_looked_at_in_a_moment() -> None:
    rng = np.random.default_rng(1)
    bits = rng.uniform(1.0, 9.0, 20 * MOST)
    cost = (1.0 + 0.01 * rng.random(len(bits))) / bits
    kept = chain(bits, cost, np.empty((0, len(bits))))
    assert len(kept) > 20
    assert np.diff(np.log(bits[kept])).max() < 0.1
