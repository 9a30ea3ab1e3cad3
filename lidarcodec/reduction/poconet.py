"""`poconet`: without what a network takes for seldom seen, cars above all; of the rest one return a cell, as `voxel`.

The network was trained on counts of observations, as PocoNet's authors made them. What pays for a localiser is the
low end of those counts, what was seen from few places; among the rest it needs what is spread, not what scores best
(docs/reduction.md). It sees one frame only: it may take a parked car for one that drives, and does not mind.
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
"""Logit from which on a return is left out: one that moves and stays costs more than many that need not have gone."""
NEAR_M: Final = 40.0
"""Beyond, all counts are low and what is left out is missed: far returns hold a localiser from afar."""


class Poconet(Reducer):
    """One return a cell, of what is likely to be there the next time too."""

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
        """Forget the side of the cells."""
        self._spread.reset()
        self._left_out = 0

    def report(self) -> dict[str, Any]:
        """`cell_m`: the side of the last frame's cells; `left_out`: its returns that were taken for seldom seen."""
        return {"cell_m": round(self._spread.side_m, 3), "left_out": self._left_out}


REDUCTION = Reduction(
    Poconet, note="removes what seems to move, such as cars and people: for localisation only, not for people who watch"
)
