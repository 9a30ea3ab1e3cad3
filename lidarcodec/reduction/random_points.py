"""`random`: returns by lot. What other reducers have to beat; the seed and the frame's index say which."""

from __future__ import annotations

import numpy as np

from lidarcodec.frame import Frame
from lidarcodec.reduction.base import Reducer, Reduction, with_kept
from lidarcodec.reduction.lots import drawn


class RandomPoints(Reducer):
    """Every return is as likely to stay as any other."""

    def reduce(self, frame: Frame) -> Frame:
        """The frame with as many returns as the budget allows, drawn by lot."""
        cells = np.flatnonzero(frame.valid).astype(np.uint32)
        count = self.budget.of(len(cells))
        if count == len(cells):
            return frame
        return with_kept(frame, drawn(cells, count, self.seed, frame.index))


REDUCTION = Reduction(RandomPoints)
