"""Which returns of a scan matter for localisation: Algorithm 1 of the PocoNet paper, in the reading that it must have.

Each return has a count: from how many places of the drive the spot that it lies on was seen. The threshold is the
highest count c for which at least a twelfth of the scan's returns have more than c; returns above it are high, the
others low, the road is ground. As printed the algorithm begins with all N returns as "greater" and runs while there
are fewer than wanted, so it never runs, returns the highest count, and selects nothing.

>>> counts = np.array([9, 9, 5, 5, 5, 1, 1, 1, 0, 0, 0, 0])
>>> threshold_of(counts, total=12, share=1 / 6)
8
>>> labels_of(counts, np.zeros(12, bool), share=1 / 6).tolist()
[2, 2, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1]
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

NONE, LOW, HIGH, GROUND = 0, 1, 2, 3
NAMES: Final = ("none", "low", "high", "ground")
SHARE: Final = 1 / 12
"""About 10,000 of a scan's returns, as the paper says."""


def threshold_of(counts: npt.NDArray[Any], total: int, share: float = SHARE) -> int:
    """The highest c so that at least `share` of `total` have a count above it; -1 where there are not that many at all.

    counts: (N,) whole numbers from 0, of the returns that are not ground;  total: all returns, ground too
    """
    if not len(counts):
        return -1
    at_least = np.cumsum(np.bincount(counts)[::-1])[::-1]  # [c]: how many have c or more
    enough = np.flatnonzero(at_least >= max(total * share, 1.0))
    return int(enough[-1]) - 1 if len(enough) else -1


def labels_of(counts: npt.NDArray[Any], ground: npt.NDArray[np.bool_], share: float = SHARE) -> npt.NDArray[np.uint8]:
    """(N,) uint8, LOW, HIGH or GROUND of each return; counts: (N,), ground: (N,). The share is of all N."""
    least = threshold_of(counts[~ground], len(counts), share)
    labels = np.where(counts > least, HIGH, LOW)
    return np.where(ground, GROUND, labels).astype(np.uint8)
