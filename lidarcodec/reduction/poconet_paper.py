"""`poconet-paper`: most of the budget for the returns that score highest, the rest for the ground, as the paper says.

The paper does not say how much: 85 % by score and 15 % of the ground by lot. It is here to be compared with. What
scores high lies side by side, so a localiser loses its way (docs/reduction.md). The scores are those of the small
network of `poconet`, not of PocoNet itself, which no vehicle can run.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from lidarcodec.frame import Frame
from lidarcodec.reduction.base import Reducer, Reduction, with_kept
from lidarcodec.reduction.lots import drawn, exactly, lots
from lidarcodec.reduction.score_network import scores_of
from lidarcodec.reduction.spread import returns_of

GROUND_SHARE: Final = 0.15


class PoconetPaper(Reducer):
    """The highest scores, and ground by lot."""

    def reduce(self, frame: Frame) -> Frame:
        """The frame with exactly as many returns as the budget allows; what one side lacks the other gets."""
        returns = returns_of(frame)
        count = self.budget.of(len(returns.cells))
        if count == len(returns.cells):
            return frame
        scores = scores_of(frame, returns.cells)
        ground = scores.is_ground
        beside, road = returns.cells[~ground], returns.cells[ground]
        wanted = min(max(round(GROUND_SHARE * count), count - len(beside)), len(road))
        order = np.lexsort((lots(beside, self.seed, frame.index), -scores.high_odds[~ground]))
        best = beside[order[: count - wanted]]
        chosen = np.concatenate([best, drawn(road, wanted, self.seed, frame.index)])
        return with_kept(frame, exactly(chosen, returns.cells, count, self.seed, frame.index))


REDUCTION = Reduction(PoconetPaper)
