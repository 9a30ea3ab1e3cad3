"""`random`: random returns, from the seed and the index of the frame. It is the baseline for other reducers."""

from __future__ import annotations

import numpy as np

from lidarcodec.frame import Frame
from lidarcodec.reduction.base import Reducer, Reduction, with_kept
from lidarcodec.reduction.lots import drawn


class RandomPoints(Reducer):
    """Keeps each return with the same probability."""

    def reduce(self, frame: Frame) -> Frame:
        """The frame with as many returns as the budget allows, drawn at random."""
        cells = np.flatnonzero(frame.valid).astype(np.uint32)
        count = self.budget.of(len(cells))
        if count == len(cells):
            return frame
        return with_kept(frame, drawn(cells, count, self.seed, frame.index))


REDUCTION = Reduction(RandomPoints)
