"""`poconet`: drops returns that a network takes for seldom seen, mostly of cars, and samples the rest as `voxel` does.

The network was trained on counts of observations, as those of PocoNet's authors. A localiser gains by dropping the low
end of the counts, surfaces that were seen from few places. The rest should be spread evenly, and not chosen by score
(docs/reduction.md). The network sees one frame only, so it may take a parked car for a moving one.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from lidarcodec.frame import Frame
from lidarcodec.reduction.base import DEFAULT_SEED, Budget, Reducer, Reduction, with_kept
from lidarcodec.reduction.lots import exactly
from lidarcodec.reduction.score_network import scores_of
from lidarcodec.reduction.spread import Spread, returns_of

SELDOM: Final = -2.0
"""Returns with a logit above this are dropped: a kept moving return costs more than many dropped still ones."""
NEAR_M: Final = 40.0
"""Further returns are never dropped for their score: all their counts are low, and a localiser needs them."""


class Poconet(Reducer):
    """Voxel sampling of the returns that are likely to be seen again."""

    def __init__(self, budget: Budget, argument: str | None = None, seed: int = DEFAULT_SEED) -> None:
        super().__init__(budget, argument, seed)
        self._spread = Spread(seed)
        self._left_out = 0

    def reduce(self, frame: Frame) -> Frame:
        """The frame with exactly as many returns as the budget allows."""
        returns = returns_of(frame)
        count = self.budget.of(len(returns.cells))
        if count == len(returns.cells):
            return frame
        scores = scores_of(frame, returns.cells)
        near = frame.range.ravel()[returns.cells] < NEAR_M / frame.sensor.range_step_m
        staying = ~((scores.seldom > SELDOM) & near & ~scores.is_ground)
        self._left_out = int(np.count_nonzero(~staying))
        rest = returns.only(staying)
        chosen = self._spread.choose(rest, min(count, len(rest.cells)), frame)
        return with_kept(frame, exactly(chosen, returns.cells, count, self.seed, frame.index))

    def reset(self) -> None:
        """Forgets the side of the voxels."""
        self._spread.reset()
        self._left_out = 0

    def report(self) -> dict[str, Any]:
        """`cell_m`: the side of the last frame's cells; `left_out`: its returns that were dropped."""
        return {"cell_m": round(self._spread.side_m, 3), "left_out": self._left_out}


REDUCTION = Reduction(
    Poconet, note="removes what seems to move, such as cars and people: for localisation only, not for people who watch"
)
