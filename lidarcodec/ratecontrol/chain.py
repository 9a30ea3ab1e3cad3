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
    more_bits = np.searchsorted(at, at, side="right")  # for each point the first with more bits
    total, following = np.full(count, np.inf), np.full(count, -1)
    total[finest] = 0.0
    for place in range(finest - 1, -1, -1):
        behind = slice(int(more_bits[place]), finest + 1)
        fits = of[behind] <= (1.0 - GAIN) * of[place]
        for row in rest:
            fits &= row[behind] <= row[place]
        found = behind.start + np.flatnonzero(fits)
        if len(found):
            whole = total[found] + of[place] * (at[found] - at[place])
            best = int(np.argmin(whole))
            total[place], following[place] = whole[best], found[best]
    # Below the first point there is no image; this costs twice as much as the worst point.
    first = int(np.argmin(total + 2.0 * of.max() * (at - at[0])))
    links = [first]
    while links[-1] != finest:
        links.append(int(following[links[-1]]))
    return order[links]


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
