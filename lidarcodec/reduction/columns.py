"""`columns:n`: every n-th column is sent. It needs the fewest bits for the keep mask, and is a simple baseline."""

from __future__ import annotations

from typing import Final

import numpy as np

from lidarcodec.frame import Frame
from lidarcodec.reduction.base import Reducer, Reduction

MOST: Final = 1000


def step_of(argument: str) -> int:
    """The n of `columns:n`.

    Raises ValueError.
    """
    if not (argument.isascii() and argument.isdigit() and 1 <= int(argument[:5]) <= MOST and len(argument) < 5):
        raise ValueError(f"columns:n keeps every n-th column, with n from 1 to {MOST}")
    return int(argument)


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
