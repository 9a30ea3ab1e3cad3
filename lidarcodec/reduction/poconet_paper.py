"""`poconet-paper`: most of the budget for the highest scores, and the rest for the ground, as in the paper.

The paper does not give the shares; here they are 85 % by score and 15 % random returns of the ground. This reducer
exists for comparison: returns with high scores are adjacent, so a localiser fails (docs/reduction.md). The scores come
from the small network of `poconet`, because PocoNet itself is too slow for a vehicle.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from lidarcodec.frame import Frame
from lidarcodec.planes.beam_directions import BeamBook
from lidarcodec.reduction.base import DEFAULT_SEED, Budget, Reducer, Reduction, with_kept
from lidarcodec.reduction.lots import drawn, exactly, lots
from lidarcodec.reduction.score_network import scores_of
from lidarcodec.reduction.spread import returns_of

GROUND_SHARE: Final = 0.15


class PoconetPaper(Reducer):
    """The highest scores, and random returns of the ground."""

    def __init__(self, budget: Budget, argument: str | None = None, seed: int = DEFAULT_SEED) -> None:
        super().__init__(budget, argument, seed)
        self._book = BeamBook()

    def reduce(self, frame: Frame) -> Frame:
        """The frame with exactly as many returns as the budget allows. If one part has too few, the other gets more."""
        returns = returns_of(frame)
        count = self.budget.of(len(returns.cells))
        if count == len(returns.cells):
            return frame
        scores = scores_of(frame, returns, self._book)
        ground = scores.is_ground
        beside, road = returns.cells[~ground], returns.cells[ground]
        wanted = min(max(round(GROUND_SHARE * count), count - len(beside)), len(road))
        order = np.lexsort((lots(beside, self.seed, frame.index), -scores.high_odds[~ground]))
        best = beside[order[: count - wanted]]
        chosen = np.concatenate([best, drawn(road, wanted, self.seed, frame.index)])
        return with_kept(frame, exactly(chosen, returns.cells, count, self.seed, frame.index))


REDUCTION = Reduction(PoconetPaper)
