"""`columns:n`: every n-th column is sent. It needs the fewest bits for the keep mask, and is a simple baseline."""

from __future__ import annotations

import numpy as np

from lidarcodec.frame import Frame
from lidarcodec.reduction.base import Reducer, Reduction, every_nth

step_of = every_nth("columns:n keeps every n-th column", most=1000)


class Columns(Reducer):
    """Keeps the first column of every n."""

    def reduce(self, frame: Frame) -> Frame:
        """The frame with all returns of the kept columns."""
        step = step_of(self.argument or "")
        if step == 1:
            return frame
        kept = np.arange(frame.width) % step == 0
        return frame.with_(keep=frame.valid & kept)


REDUCTION = Reduction(Columns, argument=step_of, example="4", budgeted=False)
