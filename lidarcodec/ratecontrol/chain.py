"""The chain of an operating curve: points from the cheapest to the finest, each better than the last in all measures.

There are many such chains. This one has the smallest area under its cost over the logarithm of the bits. A target
between two points uses the lower point, so the cost of a point counts up to the bits of the next.

>>> import numpy as np
>>> bits, cost = np.array([1.0, 2.0, 2.1, 4.0]), np.array([9.0, 5.0, 4.0, 1.0])
>>> chain(bits, cost, np.array([[3.0, 2.0, 2.0, 1.0], [8.0, 4.0, 9.0, 2.0]])).tolist()
[0, 1, 3]
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Places = npt.NDArray[np.integer[Any]]

GAIN: Final = 0.002
"""A point is better than another if its cost is smaller by at least this share."""
NEAR: Final = 1.15
"""Points are ignored if they cost more than so many times the best point with no more bits."""
MOST: Final = 800
"""Most points in the search. Its time grows with their square: 10 ms for so many."""


def chain(bits: Floats, cost: Floats, never_more: Floats) -> Places:
    """(K,) indices of the points in the chain, with increasing bits; at least one.

    bits, cost: (N,);  never_more: (Q, N), measures that must not increase along the chain
    """
    order = _near(bits, cost)
    at, of, rest = np.log(np.maximum(bits[order], 1e-9)), cost[order], never_more[:, order]
    count = len(order)
    finest = int(np.lexsort((at, of))[0])
    total, following = np.full(count, np.inf), np.full(count, -1)
    total[finest] = 0.0
    for place in range(finest - 1, -1, -1):
        behind = slice(place + 1, finest + 1)
        fits = (at[behind] > at[place]) & (of[behind] <= (1.0 - GAIN) * of[place])
        fits &= (rest[:, behind] <= rest[:, [place]]).all(axis=0)
        whole = np.where(fits, total[behind] + of[place] * (at[behind] - at[place]), np.inf)
        best = int(np.argmin(whole))
        total[place], following[place] = whole[best], place + 1 + best
    # Below the first point there is no image; this costs twice as much as the worst point.
    first = int(np.argmin(total + 2.0 * of.max() * (at - at[0])))
    found = [first]
    while found[-1] != finest:
        found.append(int(following[found[-1]]))
    return order[found]


def _near(bits: Floats, cost: Floats) -> Places:
    """Indices of the points in the search, with increasing bits."""
    order = np.lexsort((cost, bits))
    near = NEAR
    while True:
        best = np.minimum.accumulate(cost[order])
        found = order[cost[order] <= near * best]
        if len(found) <= MOST or near < 1.0 + 1e-6:
            return found
        near = 1.0 + 0.7 * (near - 1.0)
