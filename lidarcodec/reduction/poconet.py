"""`poconet`: drops returns that a network predicts to be rarely seen, mostly on cars, and samples the rest like
`voxel`.

The network was trained on counts of observations, like PocoNet. A localiser is more accurate without the lowest counts,
which are surfaces seen from few places. The rest should be spread evenly, not chosen by score (docs/reduction.md). The
network sees only one frame, so it cannot distinguish a parked car from a moving one.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from lidarcodec.frame import Frame
from lidarcodec.planes.beam_directions import BeamBook
from lidarcodec.reduction.base import DEFAULT_SEED, Budget, Reducer, Reduction, with_kept
from lidarcodec.reduction.lots import exactly
from lidarcodec.reduction.score_network import scores_of
from lidarcodec.reduction.spread import Spread, returns_of

SELDOM: Final = -2.0
"""Returns with a larger logit are dropped. A kept moving return harms more than many dropped static ones."""
NEAR_M: Final = 40.0
"""Returns beyond this distance are never dropped for their score: their counts are always low, but a localiser needs
them."""


class Poconet(Reducer):
    """Voxel sampling of returns that are probably seen again."""

    def __init__(self, budget: Budget, argument: str | None = None, seed: int = DEFAULT_SEED) -> None:
        super().__init__(budget, argument, seed)
        self._spread, self._book = Spread(seed), BeamBook()
        self._left_out = 0

    def reduce(self, frame: Frame) -> Frame:
        """The frame with exactly as many returns as the budget allows."""
        returns = returns_of(frame)
        count = self.budget.of(len(returns.cells))
        if count == len(returns.cells):
            return frame
        scores = scores_of(frame, returns, self._book)
        near = frame.range.ravel()[returns.cells] < NEAR_M / frame.sensor.range_step_m
        staying = ~((scores.seldom > SELDOM) & near & ~scores.is_ground)
        self._left_out = int(np.count_nonzero(~staying))
        rest = returns.only(staying)
        chosen = self._spread.choose(rest, min(count, len(rest.cells)), frame)
        return with_kept(frame, exactly(chosen, returns.cells, count, self.seed, frame.index))

    def reset(self) -> None:
        """Forget the size of the voxels."""
        self._spread.reset()
        self._left_out = 0

    def report(self) -> dict[str, Any]:
        """`cell_m`: voxel size of the last frame; `left_out`: number of its dropped returns."""
        return {"cell_m": round(self._spread.side_m, 3), "left_out": self._left_out}


REDUCTION = Reduction(
    Poconet, note="removes what seems to move, such as cars and people: for localisation only, not for people who watch"
)
