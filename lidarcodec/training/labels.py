"""Labels the returns that matter for localisation: Algorithm 1 of the PocoNet paper, with a correction.

Each return has a count: from how many poses of the drive its place was seen. The threshold is the highest count c for
which at least a twelfth of the scan's returns have a count above c. Returns above it are high, the others are low, and
the road is ground. The printed algorithm cannot be meant: it begins with all N returns as "greater" and loops while
there are fewer than wanted. So its loop never runs, it returns the highest count, and it selects nothing.

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
"""About 10,000 returns of a scan, as in the paper."""


def threshold_of(counts: npt.NDArray[Any], total: int, share: float = SHARE) -> int:
    """The highest c so that at least `share` of `total` returns have a count above c; -1 if there are too few returns.

    counts: (N,) whole numbers from 0, for returns that are not ground;  total: number of all returns, including ground
    """
    if not len(counts):
        return -1
    at_least = np.cumsum(np.bincount(counts)[::-1])[::-1]  # [c]: number of returns with a count of c or more
    enough = np.flatnonzero(at_least >= max(total * share, 1.0))
    return int(enough[-1]) - 1 if len(enough) else -1


def labels_of(counts: npt.NDArray[Any], ground: npt.NDArray[np.bool_], share: float = SHARE) -> npt.NDArray[np.uint8]:
    """(N,) uint8, LOW, HIGH or GROUND for each return. counts: (N,); ground: (N,); share: share of all N returns"""
    least = threshold_of(counts[~ground], len(counts), share)
    labels = np.where(counts > least, HIGH, LOW)
    return np.where(ground, GROUND, labels).astype(np.uint8)
